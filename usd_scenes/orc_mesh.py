"""From a field to a triangle mesh: surface nets on a graded grid, projection, relaxation, and the checks."""

import numpy as np

FAR = 1e3
BLOCK = 8


def graded_axis(knots):
    """Coordinates from knots [(position, spacing), ...]: the spacing varies linearly between them."""
    where, spacing = np.array(knots, float).T
    x = [where[0]]
    while x[-1] < where[-1]:
        x.append(x[-1] + np.interp(x[-1], where, spacing))
    return np.array(x)


def whole_blocks(axis):
    """The axis continued at its last spacing to a multiple of BLOCK coordinates."""
    more = -len(axis) % BLOCK
    return np.concatenate([axis, axis[-1] + (axis[-1] - axis[-2]) * np.arange(1, more + 1)])


def sample(field, axes):
    """Field values (nx, ny, nz) f32, exact in blocks near the surface and a signed constant elsewhere."""
    axes = [whole_blocks(a) for a in axes]
    counts = [len(a) // BLOCK for a in axes]
    middles = [a.reshape(-1, BLOCK).mean(1) for a in axes]
    halves = [(a.reshape(-1, BLOCK)[:, -1] - a.reshape(-1, BLOCK)[:, 0]) / 2 for a in axes]
    centers = np.stack(np.meshgrid(*middles, indexing="ij"), -1).reshape(-1, 3)
    radius = np.sqrt(sum(h**2 for h in np.meshgrid(*halves, indexing="ij"))).ravel()
    d = field(centers.astype(np.float32))
    # The field is no exact distance: half as much again, and the height of the tallest detail.
    active = np.abs(d) < 1.5 * radius + 0.5
    values = np.repeat(np.where(d < 0, -FAR, FAR)[:, None], BLOCK**3, 1).astype(np.float32)
    ids = np.flatnonzero(active)
    block = np.stack(np.unravel_index(ids, counts), 1)
    inner = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), -1).reshape(-1, 3)
    for part in np.array_split(np.arange(len(ids)), max(1, len(ids) // 400)):
        index = block[part][:, None] * BLOCK + inner
        p = np.stack([axes[c][index[..., c]] for c in range(3)], -1).reshape(-1, 3)
        values[ids[part]] = field(p.astype(np.float32)).reshape(len(part), -1)
    grid = values.reshape(*counts, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5)
    return grid.reshape([c * BLOCK for c in counts]), axes


def ambiguous(inside, axis_a, axis_b):
    """Grid faces spanned by two axes whose corners alternate, at the index of their lowest corner."""
    a, d = inside, np.roll(inside, (-1, -1), (axis_a, axis_b))
    b, c = np.roll(inside, -1, axis_a), np.roll(inside, -1, axis_b)
    return (a == d) & (b == c) & (a != b)


def lone_diagonals(inside):
    """Cells where two opposite corners alone are inside (or outside), at the index of their lowest corner."""
    corners = [np.roll(inside, (-i, -j, -k), (0, 1, 2)) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    total = sum(c.astype(np.int8) for c in corners)
    pairs = [corners[i] == corners[7 - i] for i in range(4)]
    same = pairs[0] & pairs[1] & pairs[2] & pairs[3]
    return same & ((total == 2) | (total == 6))


def untangle(values):
    """Fills in the nearest outside corner where the net would touch itself; projection moves it back in place.

    Surface nets are manifold when no grid face alternates in sign and no cell holds two sheets. Filling only
    ever turns corners inside, so it ends.
    """
    cube = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
    while True:
        inside = values < 0
        spots = [
            (ambiguous(inside, a, b), cube[cube[:, 3 - a - b] == 0]) for a, b in ((0, 1), (0, 2), (1, 2))
        ]
        spots.append((lone_diagonals(inside), cube))
        fill = np.concatenate(
            [nearest_outside(values, np.argwhere(where), corners) for where, corners in spots]
        )
        if not len(fill):
            return values
        # The new value is small: the crossing stays close to the filled corner.
        values[tuple(fill.T)] = -1e-3


def nearest_outside(values, cells, corners):
    """Of each cell's corners that lie outside, the one with the smallest value, (cells, 3)."""
    nodes = cells[:, None] + corners
    value = values[tuple(np.moveaxis(nodes, -1, 0))]
    return nodes[np.arange(len(cells)), np.where(value < 0, np.inf, value).argmin(1)]


def surface_nets(values, axes):
    """Naive surface nets (Gibson 1998): a vertex per cell with a sign change, a quad per crossed grid edge."""
    inside = values < 0
    corner = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    shape = [n - 1 for n in values.shape]

    def shifted(a, o):
        return a[tuple(slice(s, s + n) for s, n in zip(o, shape, strict=True))]

    total = sum(shifted(inside, o).astype(np.int8) for o in corner)
    cells = np.argwhere((total > 0) & (total < 8))
    ids = np.full(shape, -1, np.int64)
    ids[tuple(cells.T)] = np.arange(len(cells))
    points = crossings_mean(values, axes, cells, corner)
    quads = [quads_across(inside, ids, axis) for axis in range(3)]
    return points, np.concatenate(quads)


def crossings_mean(values, axes, cells, corner):
    """The mean of the points where the cell's twelve edges cross zero, (cells, 3)."""
    total, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for o in corner:
        for axis in range(3):
            if o[axis]:
                continue
            a, b = cells + np.array(o), cells + np.array(o) + np.eye(3, dtype=int)[axis]
            va, vb = values[tuple(a.T)].astype(float), values[tuple(b.T)].astype(float)
            cross = (va < 0) != (vb < 0)
            t = np.where(cross, va / np.where(cross, va - vb, 1), 0)[:, None]
            pa = np.stack([axes[c][a[:, c]] for c in range(3)], 1)
            pb = np.stack([axes[c][b[:, c]] for c in range(3)], 1)
            total += np.where(cross[:, None], pa + t * (pb - pa), 0)
            count += cross
    return total / count[:, None]


def quads_across(inside, ids, axis):
    """Quads of the cells around each grid edge along axis whose ends differ, wound outward."""
    first, second = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
    index = np.argwhere(first != second)
    leaving = first[tuple(index.T)]
    cell = np.moveaxis(ids, axis, 0)
    i, j, k = index.T
    ring = np.stack([cell[i, j - 1, k - 1], cell[i, j, k - 1], cell[i, j, k], cell[i, j - 1, k]], 1)
    # moveaxis puts (y, z), (x, z), (x, y) behind axis 0: the middle one is left-handed.
    flip = leaving == (axis == 1)
    ring[flip] = ring[flip][:, ::-1]
    return ring


def gradient(field, p, eps=4e-3):
    """Field gradient by the tetrahedron stencil (Quilez 2015): four evaluations, second order."""
    corners = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], float)
    return sum(c * field(p + eps * c)[:, None] for c in corners) / (4 * eps)


def project(field, p, step):
    """One Newton step along the gradient onto the zero set, no longer than step."""
    d, g = field(p), gradient(field, p)
    move = -d / np.maximum(np.einsum("ij,ij->i", g, g), 0.05)  # floor: a flat spot must not fling a vertex
    length = np.abs(move) * np.linalg.norm(g, axis=1)
    return p + (move * np.minimum(1, step / np.maximum(length, 1e-12)))[:, None] * g


def neighbour_mean(p, quads):
    """Mean of the neighbours of every vertex along the quads' edges."""
    total, count = np.zeros_like(p), np.zeros(len(p))
    for s in (1, 3):
        near = np.roll(quads, s, axis=1).ravel()
        for c in range(3):
            total[:, c] += np.bincount(quads.ravel(), p[near, c], len(p))
        count += np.bincount(quads.ravel(), minlength=len(p))
    return total / count[:, None]


def relax(field, p, quads, rounds, step):
    """Slide the vertices along the surface towards their neighbours' mean, projecting in between."""
    p = project(field, project(field, p, step), step)
    for _ in range(rounds):
        n = gradient(field, p)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        slide = neighbour_mean(p, quads) - p
        slide -= np.einsum("ij,ij->i", slide, n)[:, None] * n
        p = project(field, p + 0.6 * slide, step)
    return project(field, project(field, p, step), step)


def split_quads(p, quads):
    """Two triangles a quad, along its shorter diagonal."""
    a, b, c, d = (p[quads[:, i]] for i in range(4))
    short = np.sum((a - c) ** 2, 1) <= np.sum((b - d) ** 2, 1)
    first = np.where(short[:, None], quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    second = np.where(short[:, None], quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return np.stack([first, second], 1).reshape(-1, 3)


def mesh_field(field, axes, rounds=4, step=0.12):
    """Points (n, 3), triangles (m, 3) and unit normals (n, 3) of the field's zero set."""
    values, axes = sample(field, axes)
    points, quads = surface_nets(untangle(values), axes)
    points = relax(field, points, quads, rounds, step)
    triangles = split_quads(points, quads)
    normals = gradient(field, points)
    return (
        points,
        triangles,
        mend_normals(points, triangles, normals / np.linalg.norm(normals, axis=1, keepdims=True)),
    )


def mend_normals(points, triangles, normals):
    """Gradient normals, but those of the mesh at vertices where a triangle would face away from its own: in a
    crease finer than the mesh the field's gradient belongs to the other flank."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    smooth = np.zeros_like(points)
    for corner in range(3):
        np.add.at(smooth, triangles[:, corner], cross)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-30)
    away = np.einsum("ij,ikj->ik", cross, normals[triangles]).min(1) < 0
    doubtful = np.unique(triangles[away])
    normals = normals.copy()
    normals[doubtful] = smooth[doubtful]
    return normals


def report(points, triangles, normals):
    """The facts that a closed, manifold, well-shaped mesh must show, as a dict."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    n = len(points)
    there, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    a, b, c = (points[triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1) / 2
    sides = [np.linalg.norm(v, axis=1) for v in (b - a, c - b, a - c)]
    face_normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    agree = np.einsum("ij,ij->i", face_normal, normals[triangles].mean(1))
    shape = 4 * np.sqrt(3) * area / sum(s**2 for s in sides)
    return {
        "points": n,
        "triangles": len(triangles),
        "closed": len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back)),
        "fans": count_fans(triangles, n),
        "volume": float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6),
        "smallest_area": float(area.min()),
        "median_shape": float(np.median(shape)),
        "worst_shape": float(shape.min()),
        "facing_away": int((agree < 0).sum()),
    }


def count_fans(triangles, n):
    """Vertices whose triangles do not form a single fan (or that have none): zero for a manifold."""
    following = {}
    pairs = np.concatenate([np.roll(triangles, -s, axis=1) for s in range(3)])
    order = np.argsort(pairs[:, 0], kind="stable")
    pairs, bad = pairs[order], 0
    start = np.searchsorted(pairs[:, 0], np.arange(n + 1))
    for v in range(n):
        ring = pairs[start[v] : start[v + 1], 1:].tolist()
        following = dict(ring)
        at, steps = ring[0][0] if ring else None, 0
        while steps < len(ring) and at in following:
            at, steps = following.pop(at), steps + 1
        bad += not ring or bool(following) or at != ring[0][0]
    return bad
