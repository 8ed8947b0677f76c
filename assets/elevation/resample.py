#!/usr/bin/env python3
"""Makes jacksboro_u16.png from the Jacksboro fault elevation model: square 30 m pixels, no terraces.

    resample.py jacksboro_fault_i16.tif jacksboro_u16.png

The source is 403 x 344 whole metres, 3 arc seconds apart. Whole metres make terraces on gentle
ground, so first the smoothest surface is sought that still rounds to the source's numbers: blurred
again and again, and held within half a metre of them. An interpolating cubic B-spline, whose
curvature is continuous, then takes it to 30 m. Needs nothing but Python.
"""

import math
import struct
import sys
import zlib

SPACING_M = 30.0
LATITUDE = 36.6
SCALE_M = 0.02
OFFSET_M = 200.0
BLURS = 60


def read_tiff(path):
    """Rows of a little-endian, deflated, striped 16 bit TIFF."""
    data = open(path, "rb").read()
    assert data[:4] == b"II*\0", "not a little-endian TIFF"
    directory = struct.unpack("<I", data[4:8])[0]
    tags = {}
    for i in range(struct.unpack_from("<H", data, directory)[0]):
        tag, kind, count, value = struct.unpack_from("<HHII", data, directory + 2 + 12 * i)
        code, size = {3: ("H", 2), 4: ("I", 4)}.get(kind, ("B", 1))
        at = value if count * size > 4 else directory + 10 + 12 * i
        tags[tag] = struct.unpack_from("<%d%s" % (count, code), data, at)
    assert tags[259] == (32946,) and tags[258] == (16,) and tags.get(317, (1,)) == (1,)
    strips = zip(tags[273], tags[279])
    samples = b"".join(zlib.decompress(data[at : at + length]) for at, length in strips)
    width, height = tags[256][0], tags[257][0]
    values = struct.unpack("<%dh" % (width * height), samples)
    return [list(map(float, values[z * width : (z + 1) * width])) for z in range(height)]


def transposed(rows):
    return [list(column) for column in zip(*rows)]


def blur_rows(rows):
    """The mean with the weights 1 2 1 along every row."""
    out = []
    for row in rows:
        west, east = row[:1] + row[:-1], row[1:] + row[-1:]
        out.append([(w + 2.0 * c + e) * 0.25 for w, c, e in zip(west, row, east)])
    return out


def without_terraces(rows):
    smooth = rows
    for _ in range(BLURS):
        smooth = transposed(blur_rows(transposed(blur_rows(smooth))))
        smooth = [
            [min(max(value, exact - 0.5), exact + 0.5) for value, exact in zip(line, exact_line)]
            for line, exact_line in zip(smooth, rows)
        ]
    return smooth


def spline_coefficients(row):
    """Cubic B-spline coefficients that make the spline pass through the row's values (mirrored)."""
    pole = math.sqrt(3.0) - 2.0
    count = len(row)
    out = [6.0 * value for value in row]
    reach = min(count, 30)
    out[0] = sum(out[k] * pole**k for k in range(reach))
    for k in range(1, count):
        out[k] += pole * out[k - 1]
    out[-1] = pole / (pole * pole - 1.0) * (out[-1] + pole * out[-2])
    for k in range(count - 2, -1, -1):
        out[k] = pole * (out[k + 1] - out[k])
    return out


def resample_rows(rows, step):
    """Every row's spline at 0, step, 2 step, .. as far as it goes."""
    width = len(rows[0])
    count = int((width - 1) / step) + 1
    taps = []
    for k in range(count):
        at = k * step
        first = min(int(at), width - 2)
        t = at - first
        weights = (
            (1 - t) ** 3 / 6,
            (3 * t**3 - 6 * t**2 + 4) / 6,
            (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6,
            t**3 / 6,
        )
        columns = [abs(first - 1 + i) for i in range(4)]
        columns = [c if c < width else 2 * (width - 1) - c for c in columns]
        taps.append((columns, weights))
    out = []
    for row in rows:
        c = spline_coefficients(row)
        out.append(
            [
                c[i] * w + c[j] * x + c[k] * y + c[l] * z
                for (i, j, k, l), (w, x, y, z) in taps
            ]
        )
    return out


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path, rows):
    """16 bit grey; every row with the Paeth filter."""
    width, height = len(rows[0]), len(rows)
    above = bytes(2 * width)
    filtered = bytearray()
    for row in rows:
        line = struct.pack(">%dH" % width, *row)
        filtered.append(4)
        for i in range(2 * width):
            a = line[i - 2] if i >= 2 else 0
            b = above[i]
            c = above[i - 2] if i >= 2 else 0
            p = a + b - c
            distances = (abs(p - a), abs(p - b), abs(p - c))
            best = (a, b, c)[distances.index(min(distances))]
            filtered.append((line[i] - best) & 255)
        above = line
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", header))
        file.write(chunk(b"IDAT", zlib.compress(bytes(filtered), 9)))
        file.write(chunk(b"IEND", b""))


def main(source, target):
    # The lengths of a degree on the WGS 84 ellipsoid, at the model's middle.
    phi = math.radians(LATITUDE)
    degree_x = 111412.84 * math.cos(phi) - 93.5 * math.cos(3 * phi) + 0.118 * math.cos(5 * phi)
    degree_z = 111132.92 - 559.82 * math.cos(2 * phi) + 1.175 * math.cos(4 * phi)
    pixel_x, pixel_z = degree_x / 1200, degree_z / 1200

    rows = without_terraces(read_tiff(source))
    rows = resample_rows(rows, SPACING_M / pixel_x)
    rows = transposed(resample_rows(transposed(rows), SPACING_M / pixel_z))
    heights = [height for row in rows for height in row]
    write_png(target, [[round((h - OFFSET_M) / SCALE_M) for h in row] for row in rows])
    print(
        "pixels of %.2f m x %.2f m became %d x %d of %g m, %.1f..%.1f m high"
        % (pixel_x, pixel_z, len(rows[0]), len(rows), SPACING_M, min(heights), max(heights))
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
