#!/usr/bin/env python3
"""Values of an isotropic RGB tensor file (.bsdf) in 1/sr, independent of libbrdf: the container and the evaluation as their authors describe
them (Dupuy and Jakob 2018; the algorithm of RGL's reference loader powitacq: Marginal2D::invert, then bilinear lookup).

    rgl_reference.py FILE.bsdf DIRECTIONS.csv      theta_i,phi_i,theta_o,phi_o in radians per line -> r g b per line
"""
import struct
import sys

import numpy as np

TYPES = {1: np.uint8, 2: np.int8, 3: np.uint16, 4: np.int16, 5: np.uint32, 6: np.int32, 7: np.uint64, 8: np.int64, 9: np.float16,
         10: np.float32, 11: np.float64}


def read_tensor(name):
    data = open(name, "rb").read()
    assert data[:12] == b"tensor_file\0" and data[12:14] == b"\1\0"
    (n_fields,) = struct.unpack_from("<I", data, 14)
    at, fields = 18, {}
    for _ in range(n_fields):
        (length,) = struct.unpack_from("<H", data, at)
        key = data[at + 2:at + 2 + length].decode()
        at += 2 + length
        rank, kind, offset = struct.unpack_from("<HBQ", data, at)
        at += 11
        shape = struct.unpack_from("<%dQ" % rank, data, at)
        at += 8 * rank
        fields[key] = np.frombuffer(data, TYPES[kind], int(np.prod(shape)), offset).reshape(shape)
    return fields


def bilinear(grid, x, y):
    """grid[..., ny, nx] at x, y in [0, 1]."""
    ny, nx = grid.shape[-2:]
    px, py = np.clip(x, 0, 1) * (nx - 1), np.clip(y, 0, 1) * (ny - 1)
    ix, iy = min(int(px), nx - 2), min(int(py), ny - 2)
    fx, fy = px - ix, py - iy
    return ((1 - fy) * ((1 - fx) * grid[..., iy, ix] + fx * grid[..., iy, ix + 1])
            + fy * ((1 - fx) * grid[..., iy + 1, ix] + fx * grid[..., iy + 1, ix + 1]))


class Film:
    def __init__(self, name):
        f = read_tensor(name)
        self.theta = f["theta_i"].astype(float)
        self.ndf, self.sigma = f["ndf"].astype(float), f["sigma"].astype(float)
        self.rgb = f["rgb"][0].astype(float)
        vndf = f["vndf"][0].astype(float)
        # Each slice a density of total 1; cumulative sums of trapezoids along rows, then over rows.
        rows = np.concatenate([np.zeros(vndf.shape[:2] + (1,)), np.cumsum(0.5 * (vndf[..., 1:] + vndf[..., :-1]), axis=2)], axis=2)
        sums = rows[..., -1]
        marginal = np.concatenate([np.zeros((len(vndf), 1)), np.cumsum(0.5 * (sums[:, 1:] + sums[:, :-1]), axis=1)], axis=1)
        total = marginal[:, -1]
        self.density, self.rows, self.marginal = vndf / total[:, None, None], rows / total[:, None, None], marginal / total[:, None]

    def invert(self, density, rows, marginal, x, y):
        ny, nx = density.shape
        px, py = np.clip(x, 0, 1) * (nx - 1), np.clip(y, 0, 1) * (ny - 1)
        ix, iy = min(int(px), nx - 2), min(int(py), ny - 2)
        fx, fy = px - ix, py - iy
        r0, r1 = rows[iy, -1], rows[iy + 1, -1]
        row_density = (1 - fy) * density[iy] + fy * density[iy + 1]
        before = (1 - fy) * rows[iy, ix] + fy * rows[iy + 1, ix]
        along = before + fx * (row_density[ix] + 0.5 * fx * (row_density[ix + 1] - row_density[ix]))
        return along / ((1 - fy) * r0 + fy * r1), marginal[iy] + fy * (r0 + 0.5 * fy * (r1 - r0))

    def value(self, wi, wo):
        m = (wi + wo) / np.linalg.norm(wi + wo)
        theta_i = np.arctan2(np.hypot(wi[0], wi[1]), wi[2])
        theta_m = np.arctan2(np.hypot(m[0], m[1]), m[2])
        phi = np.arctan2(m[1], m[0]) - np.arctan2(wi[1], wi[0])
        u_m = np.sqrt(theta_m * 2 / np.pi), ((phi + np.pi) / (2 * np.pi)) % 1.0
        k = int(np.clip(np.searchsorted(self.theta, theta_i, side="right"), 1, len(self.theta) - 1))
        t = np.clip((theta_i - self.theta[k - 1]) / (self.theta[k] - self.theta[k - 1]), 0, 1)
        mix = lambda a: (1 - t) * a[k - 1] + t * a[k]
        s = self.invert(mix(self.density), mix(self.rows), mix(self.marginal), *u_m)
        sigma = bilinear(self.sigma, np.sqrt(theta_i * 2 / np.pi), 0.5)
        return bilinear(mix(self.rgb), *s) * bilinear(self.ndf, *u_m) / (4 * sigma) / wo[2]


def direction(theta, phi):
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


if __name__ == "__main__":
    film = Film(sys.argv[1])
    for line in open(sys.argv[2]):
        a = [float(x) for x in line.split(",")]
        print("%.9g %.9g %.9g" % tuple(film.value(direction(a[0], a[1]), direction(a[2], a[3]))))
