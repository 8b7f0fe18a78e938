"""Writes subdivision.json: cages in USD's words, and what OpenSubdiv makes of them at the limit.

Needs a C++ compiler and OpenSubdiv (Debian: libosd-dev 3.5.0): python make_subdivision.py [compiler flags]
"""

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
BOUNDARIES = ["none", "edgeOnly", "edgeAndCorner"]
LINEAR = ["none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all"]
INFINITE = 10.0

CUBE = {
    "points": [[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)],
    "faceVertexCounts": [4] * 6,
    "faceVertexIndices": [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5],
}
# The unfolded cube as a cross: seams, darts at their ends.
CROSS = {
    "uv": [
        [1, 0],
        [2, 0],
        [0, 1],
        [1, 1],
        [2, 1],
        [3, 1],
        [4, 1],
        [0, 2],
        [1, 2],
        [2, 2],
        [3, 2],
        [4, 2],
        [1, 3],
        [2, 3],
    ],
    "uvIndices": [10, 5, 6, 11, 8, 9, 4, 3, 12, 13, 9, 8, 3, 4, 1, 0, 7, 8, 3, 2, 10, 5, 4, 9],
}


def cage(base, **more):
    return {**base, **more}


def grid(n, height=lambda x, y: 0.1 * x * x - 0.2 * x * y, keep=lambda x, y: True):
    """n x n quads; those that `keep` takes."""
    points = [[x, y, height(x, y)] for y in range(n + 1) for x in range(n + 1)]
    faces = [
        [y * (n + 1) + x, y * (n + 1) + x + 1, (y + 1) * (n + 1) + x + 1, (y + 1) * (n + 1) + x]
        for y in range(n)
        for x in range(n)
        if keep(x, y)
    ]
    return compact(points, faces)


def compact(points, faces):
    """Without points of no face: OpenSubdiv refuses nothing, but the last level has no faces there."""
    used = sorted({v for face in faces for v in face})
    number = {v: i for i, v in enumerate(used)}
    return {
        "points": [points[v] for v in used],
        "faceVertexCounts": [len(face) for face in faces],
        "faceVertexIndices": [number[v] for face in faces for v in face],
    }


def pyramid(n):
    """An apex of valence n above an n-gon."""
    ring = [[math.cos(2 * math.pi * i / n), math.sin(2 * math.pi * i / n), 0.1 * (i % 3)] for i in range(n)]
    sides = [[i, (i + 1) % n, n] for i in range(n)]
    return compact([*ring, [0.1, 0.2, 1.3]], [list(range(n))[::-1], *sides])


def bipyramid(n):
    """Triangles only, apices of valence n."""
    ring = [[math.cos(2 * math.pi * i / n), math.sin(2 * math.pi * i / n), 0.1 * (i % 3)] for i in range(n)]
    up = [[i, (i + 1) % n, n] for i in range(n)]
    down = [[(i + 1) % n, i, n + 1] for i in range(n)]
    return compact([*ring, [0.1, 0.2, 1.3], [0, 0, -0.8]], up + down)


def fan(n):
    """Triangles around a vertex on the boundary."""
    ring = [[math.cos(2.4 * i / n), math.sin(2.4 * i / n), 0.2 * (i % 2)] for i in range(n + 1)]
    return compact([[0, 0, 0.3], *ring], [[0, i + 1, i + 2] for i in range(n)])


def triangles(quads):
    """Every quad cut in two."""
    v = quads["faceVertexIndices"]
    faces = []
    for i in range(0, len(v), 4):
        faces += [[v[i], v[i + 1], v[i + 2]], [v[i], v[i + 2], v[i + 3]]]
    return compact(quads["points"], faces)


def creased(base, chains, corners=()):
    return cage(
        base,
        creaseIndices=[v for chain, _ in chains for v in chain],
        creaseLengths=[len(chain) for chain, _ in chains],
        creaseSharpnesses=[s for _, s in chains],
        cornerIndices=[v for v, _ in corners],
        cornerSharpnesses=[s for _, s in corners],
    )


def islands():
    """Two charts over a 3 x 3 grid, cut between the second and third column and half way across a row."""
    base = grid(3)
    uv, indices, seen = [], [], {}
    for f in range(9):
        x, y = f % 3, f // 3
        chart = "right" if x == 2 else "left"
        for dx, dy in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = (x + dx, y + dy)
            cut = "above" if chart == "left" and y == 2 and corner == (0, 2) else ""
            key = (chart, corner, cut)
            if key not in seen:
                seen[key] = len(uv)
                shift = 0.7 if chart == "right" else -0.2 if cut else 0.0
                uv.append([corner[0] + shift, 1.1 * corner[1] + shift * 0.5])
            indices.append(seen[key])
    return cage(base, uv=uv, uvIndices=indices)


def cases():
    ell = grid(3, keep=lambda x, y: x == 0 or y == 0)
    yield "cube", CUBE, 2
    loop = [0, 1, 3, 2, 0]
    for sharpness in (0.5, 1.0, 1.7, 2.3, INFINITE):
        yield f"cube_crease_{sharpness:g}", creased(CUBE, [(loop, sharpness)]), 2
    yield "cube_dart", creased(CUBE, [([0, 1], INFINITE)]), 2
    yield (
        "cube_mixed",
        creased(CUBE, [([0, 1, 3], 1.3), ([1, 5], 0.6), ([2, 6], 2.2)], [(7, 0.7), (4, INFINITE), (2, 1.5)]),
        2,
    )
    yield "cube_corner_edges", creased(CUBE, [([0, 1], 3.0), ([0, 2], 0.4), ([0, 4], 1.5)]), 2
    for boundary in BOUNDARIES:
        yield f"ell_{boundary}", cage(ell, interpolateBoundary=boundary), 2
    yield "ell_crease", creased(ell, [([0, 1, 2], 1.4), ([1, 5], 2.5)]), 2
    none = creased(grid(3), [([0, 1, 2, 3], INFINITE)])
    yield "grid_none_creased", cage(none, interpolateBoundary="none"), 1
    yield "grid_holes", cage(grid(3), holeIndices=[4, 8]), 1
    yield (
        "bowtie",
        compact(
            [[0, 0, 0], [1, 0, 0], [1, 1, 0.2], [0, 1, 0], [2, 1, 0], [2, 2, 0.3], [1, 2, 0]],
            [[0, 1, 2, 3], [2, 4, 5, 6]],
        ),
        1,
    )
    fin = compact(
        [[0, 0, 0], [0, 1, 0.1], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, 1, 0], [0, 0, 1], [0, 1, 1]],
        [[0, 2, 3, 1], [4, 0, 1, 5], [0, 1, 7, 6]],
    )
    yield "fin", fin, 1
    for n in (3, 5, 6, 7, 8):
        yield f"pyramid_{n}", pyramid(n), 1
    for n in (3, 4, 5):
        yield f"pyramid_smooth_{n}", cage(pyramid(n), triangleSubdivisionRule="smooth"), 2
    for n in (3, 4, 5, 6, 7, 8):
        yield f"loop_{n}", cage(bipyramid(n), subdivisionScheme="loop"), 1
    for n in (1, 2, 3, 4, 5):
        for boundary in ("edgeOnly", "edgeAndCorner"):
            yield (
                f"loop_fan_{n}_{boundary}",
                cage(fan(n), subdivisionScheme="loop", interpolateBoundary=boundary),
                1,
            )
    octahedron = cage(bipyramid(4), subdivisionScheme="loop")
    yield "loop_crease", creased(octahedron, [([0, 1, 2, 3, 0], 1.6)], [(4, 0.8)]), 2
    yield "loop_mixed", creased(octahedron, [([0, 1], INFINITE), ([1, 4], 0.5), ([2, 5, 3], 2.1)]), 2
    yield "loop_ell", cage(triangles(ell), subdivisionScheme="loop"), 1
    for linear in LINEAR:
        yield f"uv_cross_{linear}", cage(CUBE, **CROSS, faceVaryingLinearInterpolation=linear), 2
        for boundary in ("edgeOnly", "edgeAndCorner"):
            yield (
                f"uv_islands_{linear}_{boundary}",
                cage(islands(), faceVaryingLinearInterpolation=linear, interpolateBoundary=boundary),
                1,
            )
    yield (
        "uv_creased",
        creased(
            cage(islands(), faceVaryingLinearInterpolation="cornersOnly"),
            [([5, 6], 1.4), ([9, 10], INFINITE)],
            [(6, 0.5)],
        ),
        2,
    )
    yield (
        "uv_loop",
        cage(
            octahedron,
            uv=[[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [2, 2], [2, -2]],
            uvIndices=[0, 1, 5, 1, 2, 5, 2, 3, 5, 3, 4, 5, 1, 0, 6, 2, 1, 6, 3, 2, 6, 4, 3, 6],
            faceVaryingLinearInterpolation="cornersOnly",
        ),
        1,
    )
    yield "bilinear", cage(ell, subdivisionScheme="bilinear"), 2


def listed(values):
    values = list(values)
    return " ".join(str(x) for x in [len(values), *values])


def pairs(mesh):
    """Crease chains as pairs of vertices, a sharpness for each."""
    start, ends, weights = 0, [], []
    for length, sharpness in zip(
        mesh.get("creaseLengths", []), mesh.get("creaseSharpnesses", []), strict=True
    ):
        chain = mesh["creaseIndices"][start : start + length]
        for a, b in zip(chain, chain[1:], strict=False):
            ends += [a, b]
            weights.append(sharpness)
        start += length
    return ends, weights


def spoken(mesh, level):
    """A cage as the program reads it."""
    ends, weights = pairs(mesh)
    return "\n".join(
        [
            mesh.get("subdivisionScheme", "catmullClark"),
            str(BOUNDARIES.index(mesh.get("interpolateBoundary", "edgeAndCorner"))),
            str(LINEAR.index(mesh.get("faceVaryingLinearInterpolation", "cornersPlus1"))),
            str(int(mesh.get("triangleSubdivisionRule") == "smooth")),
            str(level),
            listed(x for p in mesh["points"] for x in p),
            listed(mesh["faceVertexCounts"]),
            listed(mesh["faceVertexIndices"]),
            listed(ends),
            listed(weights),
            listed(mesh.get("cornerIndices", [])),
            listed(mesh.get("cornerSharpnesses", [])),
            listed(mesh.get("holeIndices", [])),
            listed(x for uv in mesh.get("uv", []) for x in uv),
            listed(mesh.get("uvIndices", [])),
        ]
    )


def main():
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "opensubdiv_limit"
        source = str(HERE / "opensubdiv_limit.cpp")
        subprocess.run(
            ["c++", "-std=c++14", "-O1", source, "-o", str(program), *sys.argv[1:], "-losdCPU"], check=True
        )
        entries = []
        for name, mesh, level in cases():
            done = subprocess.run(
                [str(program)], input=spoken(mesh, level), capture_output=True, text=True, check=True
            )
            json.loads("{" + done.stdout + "}")
            head = json.dumps({"name": name, "level": level, "cage": mesh})
            entries.append(head[:-1] + ",\n" + done.stdout.strip() + "}")
    (HERE / "subdivision.json").write_text("[\n" + ",\n".join(entries) + "\n]\n")


main()
