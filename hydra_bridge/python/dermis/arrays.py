"""numpy, loaded where numbers are first reckoned with: that takes a third of the time in which usd-core is loaded.

Arrays that USD holds as the core takes them go there without it (`Reader.array`).
"""

import struct
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
else:

    class Numpy:
        def __getattr__(self, name: str) -> Any:
            import numpy

            value = getattr(numpy, name)
            setattr(self, name, value)  # the next look finds it
            return value

    np = Numpy()


def single(x: float) -> float:
    """The nearest number of single precision."""
    return struct.unpack("f", struct.pack("f", x))[0]
