# SPDX-License-Identifier: GPL-3.0-or-later
"""Wavelengths of paths, spectra of colours and of hot bodies, refraction by wavelength."""
