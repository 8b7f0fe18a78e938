"""The loop of a worker: a request per line of JSON on stdin, an answer per line on stdout.

Runs in the peer's own environment, where there is no dermis: standard library and numpy only.

    {"command": "load", "folder": F, "threads": N}            -> {"version": ..., ...}
    {"command": "render", "samples": N, "seed": N, "window": [x0, y0, x1, y1], "file": F.npy}
                                                              -> {"cpu": seconds, "wall": seconds}

`cpu` is that of this process, all threads, from start to end of the render; loading and compiling are not in it.
An answer {"error": text} takes the place of either.
"""

import json
import os
import sys
import time
import traceback
from typing import Any


def serve(peer: Any) -> None:
    """Answers until stdin ends. `peer` has `load`, `prepare`, `render`, and `write`, as Mitsuba and Cycles do."""
    # Renderers print as they please: their words go to stderr, so that stdout has answers only.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        try:
            answer = answered(peer, json.loads(line))
        except Exception as error:
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def answered(peer: Any, request: dict[str, Any]) -> dict[str, Any]:
    if request["command"] == "load":
        return peer.load(request["folder"], request["threads"])
    samples, seed, window = request["samples"], request["seed"], tuple(request["window"])
    peer.prepare(samples, window)
    cpu, wall = time.process_time(), time.perf_counter()
    image = peer.render(samples, seed, window)
    cost = {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall}
    peer.write(image, request["file"])
    return cost
