#!/usr/bin/env python3
"""Three-lobe fit of the cells that bench_fit writes, by scipy.optimize.least_squares: scipy_fit.py CELLS.f64 START.json SECONDS

CELLS: rows of 8 doubles: tan^2(theta_h), Schlick's weight, G / (pi (n.wi)(n.wo) cos^4(theta_h)), three means, sigma of ln, 0.
The same residual as ours where the signal is strong, ln(f / mean) / sigma, bounds and analytic Jacobian; no robust loss.
Prints one JSON object: seconds, cost, x (kd, ks per lobe, then m and r per lobe)."""
import json
import signal
import sys
import time

import numpy as np
from scipy.optimize import least_squares

cells = np.fromfile(sys.argv[1]).reshape(-1, 8)
start = np.array(json.load(open(sys.argv[2])))
t, w, front, mean, sigma = cells[:, 0], cells[:, 1], cells[:, 2], cells[:, 3:6], cells[:, 6]
log_mean = np.log(mean)


def parts(x):
    ks, m, r = x[3:12].reshape(3, 3), np.exp(x[12:18:2]), x[13:18:2]
    bare = [np.exp(-t / m[l] ** 2) / m[l] ** 2 * front for l in range(3)]
    lobes = [(r[l] + (1 - r[l]) * w) * bare[l] for l in range(3)]
    f = np.stack([x[c] / np.pi + sum(ks[l, c] * lobes[l] for l in range(3)) for c in range(3)], axis=1)
    return ks, m, bare, lobes, f


def residuals(x):
    return ((np.log(parts(x)[4]) - log_mean) / sigma[:, None]).ravel()


def jacobian(x):
    ks, m, bare, lobes, f = parts(x)
    j = np.zeros((len(t), 3, 18))
    for c in range(3):
        scale = 1 / (f[:, c] * sigma)
        j[:, c, c] = scale / np.pi
        for l in range(3):
            j[:, c, 3 + 3 * l + c] = scale * lobes[l]
            j[:, c, 12 + 2 * l] = scale * ks[l, c] * lobes[l] * (2 * t / m[l] ** 2 - 2)
            j[:, c, 13 + 2 * l] = scale * ks[l, c] * (1 - w) * bare[l]
    return j.reshape(-1, 18)


signal.alarm(int(sys.argv[3]))  # no answer within this time: the process ends
low = np.r_[np.full(12, 1e-12), np.tile([np.log(1e-3), 0.0], 3)]
high = np.r_[np.full(12, np.inf), np.tile([0.0, 1.0], 3)]
began = time.perf_counter()
result = least_squares(residuals, np.clip(start, low + 1e-9, high - 1e-9), jacobian, bounds=(low, high), x_scale="jac", max_nfev=200)
seconds = time.perf_counter() - began
x = result.x
x[12:18:2] = np.exp(x[12:18:2])
print(json.dumps({"seconds": seconds, "cost": 2 * result.cost, "x": x.tolist()}))
