# SPDX-License-Identifier: GPL-3.0-or-later
"""Traces photons from lamps to the camera: references of caustics that no path tracer's luck is in.

Every surface that a photon meets and that the camera sees directly is connected to the camera, so that paths need not
find the lamps. What the camera sees through glass, or in a mirror, cannot be connected: those pixels stay unknown.
Geometry, cameras and BSDFs are the engine's, which are compared with Cycles one by one; the transport is not.
"""
