"""Layers that sum up to the picture."""

import numpy as np
from numpy.typing import NDArray

SUMS = (
    ("light_L0", "light_L1"),
    ("direct", "indirect", "subsurface"),
    ("diffuse", "specular", "transmission", "subsurface"),
)
"""Of scenes with two lights, /L0 and /L1."""

LAYERS = (*sorted({name for names in SUMS for name in names}), "emission")


def assert_layers_sum_up(seen: dict[str, NDArray]) -> None:
    """`seen`: a snapshot with [`LAYERS`]."""
    color = seen["color"][..., :3].astype(np.float64)
    for names in SUMS:
        together = sum(seen[name].astype(np.float64) for name in names)
        np.testing.assert_allclose(together, color, atol=2e-5 * color.max(), err_msg=str(names))
