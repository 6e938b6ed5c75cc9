#!/usr/bin/env python3
"""Where the edge of the DiLiGenT ball is: ball_outline.py FOLDER

FOLDER has 001.png ... 096.png, mask.png, Ngt.mat, light_directions.txt and light_intensities.txt of the data set. Prints circles (centre x, y and
radius, pixels; pixel (0, 0) is the centre of the first): the boundary of the mask; the sphere whose normals the normal map holds (seen from far
away, n_xy = (p - c) / R); the edge in the photographs, one colour at a time. Independent of Lacquer's code. The edge is found in 48 sectors, each
the sum of the photographs whose light is within 84 degrees of the limb's normal there:
  steepest   where the mean over the sector falls fastest, in steps of a quarter of a pixel: no model of the limb
  blur s     least squares of background + [inside] (a + b sqrt(depth) + c depth), over the pixel's square and a Gaussian of sigma s pixels;
             `misfit` is the rms of what is left, relative to the brightest value
Needs python3-scipy and python3-opencv."""
import sys

import cv2
import numpy as np
import scipy.io
from scipy.optimize import least_squares, minimize_scalar

folder, n_sectors, step = sys.argv[1], 48, 1 / 64
lights = np.loadtxt(f"{folder}/light_directions.txt")
intensities = np.loadtxt(f"{folder}/light_intensities.txt")
photographs = np.stack([cv2.imread(f"{folder}/{i + 1:03d}.png", -1)[..., ::-1] / intensities[i] for i in range(len(lights))])
mask = cv2.imread(f"{folder}/mask.png", 0) > 0
normals = scipy.io.loadmat(f"{folder}/Ngt.mat")["Ngt"]
y, x = np.mgrid[0:mask.shape[0], 0:mask.shape[1]]


def circle(points, loss="linear"):
    return least_squares(lambda c: np.hypot(points[:, 0] - c[0], points[:, 1] - c[1]) - c[2], [*points.mean(0), 70], loss=loss, f_scale=0.05).x


def show(name, c, note=""):
    print(f"{name:<28} centre {c[0]:8.3f} {c[1]:8.3f}   radius {c[2]:7.3f}   {note}")


across, down = np.argwhere(np.diff(mask, axis=1))[:, ::-1] + [0.5, 0], np.argwhere(np.diff(mask, axis=0))[:, ::-1] + [0, 0.5]
masked = circle(np.concatenate([across, down]))
show("mask, boundary of its pixels", masked, f"{mask.sum()} pixels: as large as a disc of radius {np.sqrt(mask.sum() / np.pi):.3f}")
known = np.linalg.norm(normals, axis=2) > 0.5
(sx, ox), (sy, oy) = np.polyfit(x[known], normals[..., 0][known], 1), np.polyfit(y[known], normals[..., 1][known], 1)
show("normal map", (-ox / sx, -oy / sy, 2 / (sx + sy)), f"to {np.std(normals[..., 0][known] - sx * x[known] - ox):.1g}")


def profiles(angle, blur):
    """1, sqrt(depth), depth inside an edge at 0, over pixel and blur; (distance outside, value) of each."""
    t = np.arange(-16, 16, step)
    kernel = np.ones(1)
    for side in (abs(np.cos(angle)), abs(np.sin(angle))):
        n = max(1, round(side / step))
        kernel = np.convolve(kernel, np.ones(n) / n)
    g = np.exp(-0.5 * (np.arange(-5 * blur, 5 * blur + 1e-9, step) / blur) ** 2)
    kernel = np.convolve(kernel, g / g.sum())
    where = t[0] + step * (np.arange(len(t) + len(kernel) - 1) - (len(kernel) - 1) / 2)
    depth = np.maximum(-t, 0)
    return [(where, np.convolve(f, kernel)) for f in ((t < 0) * 1.0, np.sqrt(depth), depth)]


def sectors(colour):
    """angle, distance outside the mask's circle, value of the pixels near it."""
    turn, distance = np.arctan2(y - masked[1], x - masked[0]), np.hypot(x - masked[0], y - masked[1]) - masked[2]
    for i in range(n_sectors):
        angle = 2 * np.pi * (i + 0.5) / n_sectors
        facing = lights @ [np.cos(angle), -np.sin(angle), 0] > 0.1
        near = (np.abs(np.angle(np.exp(1j * (turn - angle)))) < np.pi / n_sectors) & (np.abs(distance) < 6)
        value = photographs[facing][:, near, colour].sum(0)
        yield angle, distance[near], value / value.max()


def steepest(_, distance, value):
    edges = np.arange(-3, 3, 0.25)
    mean = [value[np.abs(distance - e) < 0.5].mean() for e in edges]
    return edges[:-1][np.argmin(np.diff(mean))] + 0.125, 0


def fitted(blur):
    def fit(angle, distance, value):
        def misfit(shift):
            a = np.stack([np.ones_like(distance)] + [np.interp(distance - shift, w, p) for w, p in profiles_here], 1)
            return np.mean((value - a @ np.linalg.lstsq(a, value, rcond=None)[0]) ** 2)
        profiles_here = profiles(angle, blur)
        coarse = min(np.arange(-1.5, 1.5, 0.05), key=misfit)
        best = minimize_scalar(misfit, bounds=(coarse - 0.06, coarse + 0.06), method="bounded", options={"xatol": 1e-4})
        return best.x, best.fun
    return fit


for colour, name in ((1, "green"), (0, "red"), (2, "blue")):
    for label, edge in [("steepest", steepest)] + [(f"blur {b}", fitted(b)) for b in ((0.05, 0.2, 0.35, 0.5, 0.7) if colour == 1 else (0.05,))]:
        found = [(a, *edge(a, d, v)) for a, d, v in sectors(colour)]
        points = np.array([[masked[0] + (masked[2] + r) * np.cos(a), masked[1] + (masked[2] + r) * np.sin(a)] for a, r, _ in found])
        c = circle(points, "cauchy")
        scatter = np.median(np.abs(np.hypot(points[:, 0] - c[0], points[:, 1] - c[1]) - c[2])) * 1.4826
        misfit = np.sqrt(np.median([m for _, _, m in found]))
        show(f"photographs, {name}, {label}", c, f"scatter {scatter:.3f}" + (f", misfit {misfit:.4f}" if misfit else ""))
