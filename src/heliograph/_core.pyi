"""Native kernels of Heliograph; private, wrapped by the Python rooms."""

from typing import Annotated

import numpy
from numpy.typing import NDArray


class Scene:
    def __init__(self, packed: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order='C', device='cpu', writable=False)], shapes: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None: ...

    def __len__(self) -> int: ...

    def cast(self, directions: NDArray[numpy.float64], T_world_sensor: NDArray[numpy.float64], min_range: float, max_range: float, threads: int) -> tuple[NDArray[numpy.float64], NDArray[numpy.float32], NDArray[numpy.int32]]: ...
