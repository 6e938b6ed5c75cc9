#!/usr/bin/env python3
"""Prints the reference values of test_cook_torrance.cpp: the formula of Guenther et al. 2005, Table 1, word by word, with 60 digits.

Independent of libbrdf: vectors and dot products only, D, F, G as the paper states them.   python3 cook_torrance_reference.py
"""
from mpmath import mp, mpf, sin, cos, exp, log, pi, sqrt

mp.dps = 60

PAINTS = {
    "polaris_silber": (["0.055", "0.063", "0.071"],
                       [(["0.065", "0.082", "0.088"], "0.38", "1.0"), (["0.11", "0.13", "0.13"], "0.17", "0.92"),
                        (["0.008", "0.013", "0.015"], "0.013", "0.9")]),
    "white": (["0.61", "0.63", "0.55"],
              [(["2.6e-6", "0.00031", "3.1e-8"], "1.0", "0.049"), (["0.013", "0.011", "0.0083"], "0.15", "0.45"),
               (["0.049", "0.042", "0.037"], "0.015", "0.17")]),
    "ford_f8": (["0.0012", "0.0015", "0.0018"],
                [(["0.0049", "0.0076", "0.012"], "0.32", "0.15"), (["0.01", "0.013", "0.018"], "0.11", "0.087"),
                 (["0.007", "0.0065", "0.0077"], "0.013", "0.9")]),
}
# theta_i, phi_i, theta_o, phi_o in degrees
ANGLES = [("0", "0", "0", "0"), ("30", "0", "30.5", "180"), ("30", "0", "31.2", "178"), ("45", "0", "20", "90"),
          ("60", "10", "60", "10"), ("75", "0", "70", "180"), ("75", "0", "10", "0"), ("80", "0", "80", "175"),
          ("89.9", "0", "89", "180"), ("89.9", "0", "5", "30"), ("50", "20", "48", "170"), ("10", "300", "65", "40")]


def direction(theta_deg, phi_deg):
    t, p = mpf(theta_deg) * pi / 180, mpf(phi_deg) * pi / 180
    return [sin(t) * cos(p), sin(t) * sin(p), cos(t)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def lobe(m, r, wi, wo):
    n = [mpf(0), mpf(0), mpf(1)]
    s = [a + b for a, b in zip(wi, wo)]
    h = [x / sqrt(dot(s, s)) for x in s]
    nh, ni, no, oh = dot(n, h), dot(n, wi), dot(n, wo), dot(wo, h)
    tan2 = (1 - nh**2) / nh**2
    D = exp(-tan2 / m**2) / (m**2 * nh**4)
    F = r + (1 - r) * (1 - dot(wi, h))**5
    G = min(mpf(1), 2 * nh * no / oh, 2 * nh * ni / oh)
    return F * D * G / (ni * no)


def brdf(paint, wi, wo):
    kd, lobes = PAINTS[paint]
    return [mpf(kd[c]) / pi + sum(mpf(ks[c]) / pi * lobe(mpf(m), mpf(r), wi, wo) for ks, m, r in lobes) for c in range(3)]


if __name__ == "__main__":
    for paint in PAINTS:
        print(f"// {paint}")
        for a in ANGLES:
            f = brdf(paint, direction(*a[:2]), direction(*a[2:]))
            print("    {%s, {%s}}," % (", ".join(a), ", ".join(mp.nstr(v, 17) for v in f)))
    print("// log of one lobe, ks = 1, m = 0.013, r = 0.9, theta_h = 10 30 60 80 deg in the plane of incidence, theta_d = 5 deg")
    for theta_h in (10, 30, 60, 80):
        wi, wo = direction(theta_h + 5, 0), direction(theta_h - 5, 0)
        print(theta_h, mp.nstr(log(lobe(mpf("0.013"), mpf("0.9"), wi, wo) / pi), 17))
