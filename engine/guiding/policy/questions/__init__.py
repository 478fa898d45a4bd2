# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render asks of itself: whether guiding, a method, a network, media, roulette or the cache is worth it."""
