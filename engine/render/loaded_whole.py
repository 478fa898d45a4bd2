# SPDX-License-Identifier: GPL-3.0-or-later
"""What `byte_code` loads last: where byte code of this module lies, that of all others does."""
