#!/usr/bin/env python3
"""Fits of a measured film by scipy.optimize.least_squares from several random starts: scipy_films.py CELLS.f64 LOBES STARTS

CELLS: rows of 9 doubles: tan^2(theta_h), Schlick's weight, G / (pi (n.wi)(n.wo) cos^4(theta_h)), three targets, three signed 1 / sigma
(negative: compared linearly, 0: not used). The objective of lacquer fit written anew: ln((f + t) / (target + t)) / sigma with
t = target / 1000, or (f - target) / sigma, Huber's loss from 3. Prints one JSON object: cost (sum of the robust squares) of every start."""
import json
import sys
import time

import numpy as np
from scipy.optimize import least_squares

cells = np.fromfile(sys.argv[1]).reshape(-1, 9)
n, starts = int(sys.argv[2]), int(sys.argv[3])
t, w, front, target, weight = cells[:, 0], cells[:, 1], cells[:, 2], cells[:, 3:6], np.abs(cells[:, 6:9])
linear = cells[:, 6:9] < 0
floor = 1e-3 * target


def parts(x):
    ks, m, r = x[3:3 + 3 * n].reshape(n, 3), np.exp(x[3 + 3 * n::2]), x[4 + 3 * n::2]
    bare = [np.exp(-t / m[l] ** 2) / m[l] ** 2 * front for l in range(n)]
    lobes = [(r[l] + (1 - r[l]) * w) * bare[l] for l in range(n)]
    f = x[:3] / np.pi + sum(np.outer(lobes[l], ks[l]) for l in range(n))
    return ks, m, bare, lobes, f


def residuals(x):
    f = parts(x)[4]
    log = np.log(np.where(linear, 1, f + floor) / np.where(linear, 1, target + floor))
    return (weight * np.where(linear, f - target, log)).ravel()


def jacobian(x):
    ks, m, bare, lobes, f = parts(x)
    scale = weight * np.where(linear, 1, 1 / np.where(linear, 1, f + floor))
    j = np.zeros((len(t), 3, len(x)))
    for c in range(3):
        j[:, c, c] = scale[:, c] / np.pi
        for l in range(n):
            j[:, c, 3 + 3 * l + c] = scale[:, c] * lobes[l]
            j[:, c, 3 + 3 * n + 2 * l] = scale[:, c] * ks[l, c] * lobes[l] * (2 * t / m[l] ** 2 - 2)
            j[:, c, 4 + 3 * n + 2 * l] = scale[:, c] * ks[l, c] * (1 - w) * bare[l]
    return j.reshape(-1, len(x))


low = np.r_[np.full(3 + 3 * n, 0.0), np.tile([np.log(1e-3), 0.0], n)]
high = np.r_[np.full(3 + 3 * n, np.inf), np.tile([0.0, 1.0], n)]
random = np.random.default_rng(1)
costs, began = [], time.perf_counter()
for _ in range(starts):
    kd = np.maximum(np.median(target, axis=0), 1e-4) * np.pi * random.uniform(0.2, 1)
    shapes = np.ravel(np.column_stack([np.sort(random.uniform(np.log(0.004), -0.05, n))[::-1], random.uniform(0.05, 0.95, n)]))
    start = np.r_[kd, np.exp(random.uniform(np.log(1e-3), np.log(0.2), 3 * n)), shapes]
    result = least_squares(residuals, start, jacobian, bounds=(low, high), x_scale="jac", loss="huber", f_scale=3, max_nfev=1000,
                           ftol=1e-12, xtol=1e-12, gtol=1e-12)
    costs.append(2 * result.cost)
print(json.dumps({"seconds": time.perf_counter() - began, "costs": costs}))
