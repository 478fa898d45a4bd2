# SPDX-License-Identifier: GPL-3.0-or-later
"""Angles and their functions, where those of `math` would be most of a kernel's time.

The system's library takes 9 to 20 ns a call and can be neither inlined nor mixed with other work. These are polynomials
for a half-circle, as precise as float32 is: Chebyshev series of the functions over their argument, in its square.
"""

from engine.kernels.constants import HALF_PI, PI
from engine.kernels.eight import absolute, choose
from engine.runtime.jit import kernel


@kernel
def upper_angle(y, x):
    """`math.atan2` of y >= 0: angle [rad] in [0, pi], relative error up to 3e-7. Of eight numbers each, or of one."""
    size = absolute(x)
    is_steep = y > size
    largest = choose(is_steep, y, size)
    ratio = choose(is_steep, size, y) / choose(largest > 0.0, largest, 1.0)
    z = ratio * ratio
    series = 0.042587608 + z * (-0.01600503 + z * 0.0028340642)
    series = 0.10636754 + z * (-0.07495446 + z * series)
    series = 0.19992484 + z * (-0.14202571 + z * series)
    angle = ratio * (1.0 + z * (-0.33333066 + z * series))
    angle = choose(is_steep, HALF_PI - angle, angle)
    return choose(x >= 0.0, angle, PI - angle)


@kernel
def sine_and_cosine(angle):
    """Sine and cosine of an angle [rad] in [0, pi]; errors up to 3e-7, the sine's relative below a right angle. Of
    eight angles, or of one."""
    is_obtuse = angle > HALF_PI
    acute = choose(is_obtuse, PI - angle, angle)
    z = acute * acute
    sine = acute * (1.0 + z * (-0.16666658 + z * (0.008333051 + z * (-0.00019809046 + z * 2.6051662e-6))))
    series = -0.001388836 + z * (2.4760135e-5 + z * -2.6051077e-7)
    cosine = 1.0 + z * (-0.5 + z * (0.041666635 + z * series))
    return sine, choose(is_obtuse, 0.0 - cosine, cosine)
