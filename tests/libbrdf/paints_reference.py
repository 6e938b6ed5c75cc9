#!/usr/bin/env python3
"""Prints the reference values of test_files_paints.cpp: Table 1 of Guenther et al. 2005 evaluated with vectors and dot products.

Independent of libbrdf: the parameters are copied from the table, D, F and G are written as the paper has them, double precision.
    python3 paints_reference.py
"""
from math import cos, exp, pi, radians, sin, sqrt

# name: kd, then (ks, m, r) of the three lobes
PAINTS = {
    "ford-f8": ([0.0012, 0.0015, 0.0018], ([0.0049, 0.0076, 0.012], 0.32, 0.15), ([0.01, 0.013, 0.018], 0.11, 0.087),
                ([0.007, 0.0065, 0.0077], 0.013, 0.9)),
    "polaris-silber": ([0.055, 0.063, 0.071], ([0.065, 0.082, 0.088], 0.38, 1.0), ([0.11, 0.13, 0.13], 0.17, 0.92),
                       ([0.008, 0.013, 0.015], 0.013, 0.9)),
    "opel-titan": ([0.011, 0.013, 0.015], ([0.057, 0.066, 0.078], 0.38, 0.85), ([0.1, 0.12, 0.13], 0.17, 0.86),
                   ([0.0095, 0.014, 0.016], 0.014, 0.9)),
    "bmw-339": ([0.012, 0.015, 0.016], ([0.062, 0.076, 0.08], 0.39, 0.92), ([0.11, 0.12, 0.12], 0.17, 0.87),
                ([0.0083, 0.015, 0.016], 0.013, 0.9)),
    "2k-acrylack": ([0.42, 0.32, 0.1], ([0, 0, 0], 0.88, 1.0), ([0.028, 0.026, 0.006], 0.8, 0.9),
                    ([0.017, 0.0075, 0.0041], 0.015, 0.17)),
    "white": ([0.61, 0.63, 0.55], ([2.6e-6, 0.00031, 3.1e-8], 1.0, 0.049), ([0.013, 0.011, 0.0083], 0.15, 0.45),
              ([0.049, 0.042, 0.037], 0.015, 0.17)),
    "blue": ([0.0079, 0.023, 0.1], ([0.0011, 0.0015, 0.0019], 0.15, 1.0), ([0.025, 0.03, 0.043], 0.043, 0.094),
             ([0.059, 0.074, 0.082], 0.02, 0.17)),
    "blue-matte": ([0.0099, 0.036, 0.12], ([0.0032, 0.0045, 0.0059], 0.16, 1.0), ([0.18, 0.23, 0.28], 0.075, 0.046),
                   ([0.04, 0.049, 0.051], 0.034, 0.17)),
}
# theta_i, phi_i, theta_o, phi_o in degrees: near the mirror direction, off the peak, grazing
ANGLES = [(30, 0, 31, 180), (20, 15, 45, 160), (70, 0, 65, 120)]


def direction(theta, phi):
    t, p = radians(theta), radians(phi)
    return (sin(t) * cos(p), sin(t) * sin(p), cos(t))


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def lobe(wi, wo, m, r):
    total = [a + b for a, b in zip(wi, wo)]
    h = [x / sqrt(dot(total, total)) for x in total]
    ni, no, nh, oh = wi[2], wo[2], h[2], dot(wo, h)
    distribution = exp(-(1 - nh**2) / nh**2 / m**2) / (m**2 * nh**4)
    fresnel = r + (1 - r) * (1 - dot(wi, h))**5
    geometry = min(1, 2 * nh * no / oh, 2 * nh * ni / oh)
    return fresnel * distribution * geometry / (ni * no) / pi


for name, (kd, *lobes) in PAINTS.items():
    for angles in ANGLES:
        wi, wo = direction(*angles[:2]), direction(*angles[2:])
        f = [kd[c] / pi + sum(ks[c] * lobe(wi, wo, m, r) for ks, m, r in lobes) for c in range(3)]
        print('{"%s", {%s}, {%s}},' % (name, ", ".join(map(str, angles)), ", ".join("%.12g" % x for x in f)))
