"""Models the orc and writes orc_meshes.usdc, orc.usda and textures/orc_*.jpg beside this file.

    python usd_scenes/orc_model.py [--coarseness 1.3] [--out DIR]

Needs numpy, usd-core and OpenImageIO. The meshes are checked before they are written: closed, manifold, outward, no
degenerate triangles. Takes a few minutes.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from orc_eyes import cornea, eye_map, eyeball, tear_line
from orc_hair import tufts
from orc_maps import skin_maps, write_maps
from orc_mesh import graded_axis, mesh_field, report
from orc_parts import earring, tusk
from orc_scene import EYE_HEIGHT, around, stage_text, write_meshes
from orc_sdf import vec
from orc_shape import EYE_CENTER, EYE_RADIUS, sculpt

# Grid spacing in cm along X, Y and Z, (position, spacing): finest on the face, coarse on the shoulders.
GRADES = (
    ((-23, 0.45), (-19, 0.24), (-8, 0.16), (-5, 0.115), (5, 0.115), (8, 0.16), (19, 0.24), (23, 0.45)),
    ((-25, 0.5), (-15, 0.32), (-12, 0.14), (5, 0.115), (10, 0.22), (11.5, 0.3)),
    ((-13.5, 0.35), (-8, 0.15), (0, 0.15), (5, 0.115), (11.8, 0.115)),
)
CAMERA, TARGET = around(24, 1.5, 118), (1.6, EYE_HEIGHT - 2.4, 0)
GAZE = {1: (17, 1), -1: (20, 1)}


def axes(coarseness):
    return [graded_axis([(at, spacing * coarseness) for at, spacing in grade]) for grade in GRADES]


def model(coarseness):
    """All meshes by prim name; left and right are the orc's own, his left is +X."""
    field = sculpt()
    return {
        "Skin": mesh_field(field, axes(coarseness)),
        "EyeLeft": eyeball(1, GAZE[1]),
        "EyeRight": eyeball(-1, GAZE[-1]),
        "CorneaLeft": cornea(1, GAZE[1]),
        "CorneaRight": cornea(-1, GAZE[-1]),
        "TearLeft": tear_line(field, 1),
        "TearRight": tear_line(field, -1),
        "TuskLeft": tusk(1),
        "TuskRight": tusk(-1, shorter=0.1),
        "Earring": earring(),
    }


def check(name, mesh):
    """The report of a mesh, as stored in single precision; raises on what a path tracer could trip over."""
    points, triangles, normals = mesh[:3]
    facts = report(points.astype(np.float32).astype(float), triangles, normals)
    sound = facts["closed"] and facts["fans"] == 0 and facts["volume"] > 0 and facts["smallest_area"] > 1e-7
    if not sound or facts["facing_away"]:
        raise SystemExit(f"{name} is not sound: {facts}")
    return facts


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--coarseness", type=float, default=1.3, help="factor on the grid spacing")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args(arguments)
    meshes = model(options.coarseness)
    for name, mesh in meshes.items():
        print(name, check(name, mesh))
    points, triangles, normals = meshes["Skin"][:3]
    write_meshes(options.out / "orc_meshes.usdc", meshes, tufts(points, normals))
    write_maps(options.out / "textures", {**skin_maps(points, normals, triangles), "eye": eye_map()})
    eye = EYE_CENTER + vec(0.2, EYE_HEIGHT, EYE_RADIUS)
    (options.out / "orc.usda").write_text(stage_text(CAMERA, TARGET, eye))


if __name__ == "__main__":
    main(sys.argv[1:])
