"""Native kernels of Heliograph; private, wrapped by the Python rooms."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

from types import ModuleType

testing: ModuleType  # evaluate_factors, retract_values

def instruction_set() -> str: ...

class SurfaceCloud:
    def __init__(
        self,
        points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        voxel: float,
        levels: int,
        max_thickness: float,
        min_support: int,
        threads: int,
    ) -> None: ...
    def levels(self) -> int: ...
    def finite(self) -> int: ...
    def size(self, level: int) -> int: ...
    def extent(self, level: int) -> float: ...
    def spread(self, level: int) -> NDArray[numpy.float64]: ...
    def source(self) -> NDArray[numpy.uint32]: ...
    def elements(self, level: int) -> tuple[Any, ...]: ...
    def overlap(
        self,
        level: int,
        source: SurfaceCloud,
        source_level: int,
        T: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        reach: float,
        threads: int,
        stride: int = 1,
    ) -> float: ...

class RangeImage:
    def __init__(
        self,
        points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        cell: float,
    ) -> None: ...
    def sight(
        self,
        target: SurfaceCloud,
        source: SurfaceCloud,
        level: int,
        T: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        reach: float,
        threads: int,
    ) -> tuple[Any, ...]: ...

def point_features(cloud: SurfaceCloud, level: int, radius: float, threads: int) -> NDArray[numpy.float32]: ...
def nearest_features(
    a: Annotated[NDArray[numpy.float32], dict(shape=(None, 33), order="C", device="cpu", writable=False)],
    b: Annotated[NDArray[numpy.float32], dict(shape=(None, 33), order="C", device="cpu", writable=False)],
    count: int,
    threads: int,
) -> NDArray[numpy.int32]: ...
def consistent_sets(
    p: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    q: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    normal_p: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    normal_q: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    tolerance: float,
    max_angle: float,
    seeds: int,
    threads: int,
) -> tuple[Any, ...]: ...

class Matcher:
    def __init__(
        self, target: SurfaceCloud, target_level: int, source: SurfaceCloud, source_level: int, stride: int = 1
    ) -> None: ...
    def sums(
        self,
        T: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        residual: int,
        by_cube: bool,
        gate: float,
        kernel: float,
        sigma: float,
        min_cosine: float,
        one_sided: bool,
        keep: bool,
        threads: int,
    ) -> tuple[Any, ...]: ...
    def matches(
        self,
        T: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        residual: int,
        by_cube: bool,
        gate: float,
        kernel: float,
        sigma: float,
        min_cosine: float,
        one_sided: bool,
        threads: int,
    ) -> NDArray[numpy.float64]: ...

def deskew(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    offsets_ns: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    times_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    R_ref_body: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    p_ref_body: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    threads: int,
) -> NDArray[numpy.float32]: ...
def voxel_downsample(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    leaf: float,
) -> NDArray[numpy.int32]: ...
def range_gate(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    min_range: float,
    max_range: float,
) -> NDArray[numpy.int32]: ...
def scan_lines(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    offsets_ns: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    rows: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def elevation_rows(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    row_height: float,
) -> tuple[Any, ...]: ...
def step_angle(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    stride: int,
) -> float: ...
def scan_features(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    starts: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    window: int,
    region: int,
    edge_curvature: float,
    plane_curvature: float,
    noise: float,
    edges: int,
    planes: int,
    map_edges: int,
    map_stride: int,
    gap: float,
    grazing: float,
    threads: int,
) -> tuple[Any, ...]: ...

class FeatureMatches:
    def __len__(self) -> int: ...
    def table(self) -> NDArray[numpy.float64]: ...
    def sum(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        shares: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        gate: float,
        kernel: float,
        sigma: float,
        threads: int,
    ) -> tuple[Any, ...]: ...

class FeatureMap:
    def __init__(
        self,
        edges: bool,
        voxel: float,
        max_points: int,
        neighbours: int,
        reach: float,
        max_thickness: float,
        min_spread: float,
    ) -> None: ...
    def insert(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    ) -> float: ...
    def prune(
        self,
        centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
        radius: float,
        max_cells: int,
    ) -> None: ...
    def clear(self) -> None: ...
    def match(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        sigma: float,
        threads: int,
    ) -> FeatureMatches: ...
    def cells(self) -> NDArray[numpy.float64]: ...
    def save(self) -> bytes: ...
    def load(self, state: bytes) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...

class GlobalMap:
    def __init__(self, voxel: float) -> None: ...
    def insert(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        intensity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        T_map_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def merge(
        self,
        cubes: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        sums: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        intensity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        counts: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        T_map_odom: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)]
        | None,
        visit: int,
    ) -> None: ...
    def keep(
        self, wanted: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def clear(self) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def points(self) -> NDArray[numpy.float64]: ...
    def intensity(self) -> NDArray[numpy.float32]: ...
    def counts(self) -> NDArray[numpy.float32]: ...
    def visits(self) -> NDArray[numpy.uint32]: ...
    def first(self) -> NDArray[numpy.uint32]: ...
    def cubes(self) -> NDArray[numpy.int32]: ...
    def sums(self) -> NDArray[numpy.float32]: ...
    def intensity_sums(self) -> NDArray[numpy.float32]: ...
    def surfaces(self, thickness: float, threads: int) -> tuple[Any, ...]: ...
    def normals(
        self, cells: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float32]: ...
    def marked_around(
        self,
        cells: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        marked: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> NDArray[numpy.uint32]: ...

def split_tiles(
    cubes: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    edge: int,
    halo: int,
) -> tuple[Any, ...]: ...
def count_seen_through(
    places: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    normals: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    ends: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    start: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    radius: float,
    reach: float,
    margin: float,
    grazing: float,
    votes: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu")],
) -> None: ...

class GraphProblem:
    def __init__(
        self,
        code: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        dof: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        count: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def add_group(
        self,
        type: int,
        variables: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
        rows: int,
        measurement: Annotated[
            NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)
        ],
        noise: int,
        shared: bool,
        sqrt_information: Annotated[
            NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        kernel: int,
        width: float,
    ) -> int: ...
    def set_custom(
        self,
        group: int,
        residual: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
        jacobians: Sequence[
            Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order="C", device="cpu", writable=False)]
        ],
    ) -> None: ...
    def set_weights(
        self,
        group: int,
        weights: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def set_shift(
        self,
        group: int,
        shift: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def set_noise(
        self,
        group: int,
        sqrt_information: Annotated[
            NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
    ) -> None: ...
    def hold(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def set_values(
        self, values: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def values(self) -> NDArray[numpy.float64]: ...
    def candidate(self) -> NDArray[numpy.float64]: ...
    def step(self) -> NDArray[numpy.float64]: ...
    def set_step(
        self, step: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def analyze(self, method: int) -> None: ...
    def analyze_in(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def elimination_order(self) -> NDArray[numpy.int32]: ...
    def linearize(self, threads: int) -> tuple[Any, ...]: ...
    def cost(self, candidate: bool, threads: int) -> tuple[Any, ...]: ...
    def factorize(self, damping: float, floor: float, threads: int) -> int: ...
    def solve(self, damping: float, floor: float) -> float: ...
    def solve_for(
        self,
        right: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    ) -> NDArray[numpy.float64]: ...
    def gradient(self) -> NDArray[numpy.float64]: ...
    def diagonal(self) -> NDArray[numpy.float64]: ...
    def multiply(
        self, v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    def retract(self) -> None: ...
    def accept(self) -> None: ...
    def residuals(self, group: int) -> tuple[Any, ...]: ...
    def jacobians(self, group: int) -> tuple[Any, ...]: ...
    def blocks(self) -> NDArray[numpy.float64]: ...
    def plan(self) -> dict[str, Any]: ...

class GraphInverse:
    def __init__(self, problem: GraphProblem) -> None: ...
    def covariance_blocks(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...

def graph_free_space(
    problem: GraphProblem,
    assumed: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    most_columns: int,
) -> tuple[Any, ...]: ...
def graph_components(problem: GraphProblem) -> int: ...
def graph_least_pivot(problem: GraphProblem) -> float: ...
def read_rows(text: bytes, tags: Sequence[str]) -> tuple[Any, ...]: ...
def format_rows(
    tag: str,
    integers: Annotated[NDArray[numpy.int64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    numbers: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def spanning_start(
    count: int,
    i: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    j: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    relative: Annotated[
        NDArray[numpy.float64], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
    ],
) -> tuple[Any, ...]: ...
def order_minimum_degree(
    offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    neighbour: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    weight: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    group: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> NDArray[numpy.int32]: ...
def order_nested_dissection(
    offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    neighbour: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    weight: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> NDArray[numpy.int32]: ...
def order_fill(
    offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    neighbour: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    weight: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def covariance_roots(
    P: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def pack_single(
    manifold: int,
    value: Annotated[NDArray[numpy.float64], dict(device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu")],
) -> bool: ...
def is_sound(manifold: int, value: Annotated[NDArray[numpy.float64], dict(device="cpu", writable=False)]) -> bool: ...
def evaluate_factors(
    type: int,
    families: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    values: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    variables: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    rows: int,
    measurement: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    noise: int,
    shared_noise: bool,
    sqrt_information: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    kernel: int,
    kernel_width: float,
    weight: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    shift: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    custom: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...

class TreeCounts:
    @property
    def variables(self) -> int: ...
    @property
    def cliques(self) -> int: ...
    @property
    def factors(self) -> int: ...
    @property
    def linearized(self) -> int: ...
    @property
    def solved(self) -> int: ...
    @property
    def work(self) -> float: ...

class PassReport:
    @property
    def relinearized(self) -> int: ...
    @property
    def caught_up(self) -> int: ...
    @property
    def undetermined(self) -> int: ...
    @property
    def seconds(self) -> list[float]: ...

class CliqueTable:
    @property
    def number(self) -> NDArray[numpy.int32]: ...
    @property
    def parent(self) -> NDArray[numpy.int32]: ...
    @property
    def pivots(self) -> NDArray[numpy.int32]: ...
    @property
    def sizes(self) -> NDArray[numpy.int32]: ...
    @property
    def variables(self) -> NDArray[numpy.int32]: ...
    @property
    def made(self) -> NDArray[numpy.int32]: ...

class BayesTree:
    def __init__(self) -> None: ...
    def add_variables(
        self,
        manifold: int,
        dof: int,
        packed: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> NDArray[numpy.int32]: ...
    def hold(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def add_kind(
        self,
        type: int,
        manifolds: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        dofs: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        rows: int,
        noise: int,
        kernel: int,
        width: float,
        measurement: int,
    ) -> int: ...
    def add_factors(
        self,
        kind: int,
        variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        measurement: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
        sqrt_information: Annotated[
            NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        let_go: bool = False,
    ) -> NDArray[numpy.int32]: ...
    def add_single_factors(self, staged: list[Any]) -> NDArray[numpy.int32]: ...
    def remove_factors(
        self, factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def has_factors(
        self, factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> bool: ...
    def weigh_factors(
        self,
        factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        weights: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def let_go(
        self, factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def take_back(
        self, factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def relinearize(self, threshold: float, max: int, farthest_first: bool) -> int: ...
    def find_fluid(self, threshold: float) -> None: ...
    def detach(self) -> None: ...
    def stale_factors(self, kind: int) -> NDArray[numpy.int32]: ...
    def set_custom(
        self,
        factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        residual: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
        jacobians: Sequence[
            Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)]
        ],
    ) -> None: ...
    def reorder(self) -> None: ...
    def eliminate(self, max: int) -> int: ...
    def advance(
        self,
        threshold: float,
        relinearize: int,
        farthest_first: bool,
        eliminate: int,
        wildfire: float,
        fluid_threshold: float,
        steps: int,
        deferred_steps: int,
    ) -> PassReport: ...
    def undo(self) -> None: ...
    def solve(self, wildfire: float, relinearize: float, max: int, max_deferred: int) -> int: ...
    def finish_steps(self) -> None: ...
    def leave(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def drop_left(self) -> NDArray[numpy.int32]: ...
    def counts(self) -> TreeCounts: ...
    def factors_of(self, variable: int) -> NDArray[numpy.int32]: ...
    def held(self, variable: int) -> bool: ...
    def estimate(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    def linearization_point(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    def delta(self) -> NDArray[numpy.float64]: ...
    def covariance(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    def joint_covariance(
        self, variables: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    def clique_table(self) -> CliqueTable: ...
    def largest_step(self) -> float: ...
    def cost(self) -> float: ...
    def factor_data(self, factor: int) -> tuple[Any, ...]: ...
    def squared(
        self,
        factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        since: int,
    ) -> NDArray[numpy.float64]: ...
    def innovations(
        self, factors: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)]
    ) -> NDArray[numpy.float64]: ...
    @property
    def solves(self) -> int: ...
    def save(self) -> bytes: ...
    def load(self, state: bytes) -> None: ...
    def variable_families(self) -> NDArray[numpy.int32]: ...
    def kind_table(self) -> NDArray[numpy.int32]: ...
    def factor_kinds(self) -> NDArray[numpy.int32]: ...
    def bytes(self) -> int: ...
    @property
    def variables(self) -> int: ...
    @property
    def slots(self) -> int: ...
    @property
    def cliques(self) -> int: ...
    @property
    def factors(self) -> int: ...
    @property
    def waiting(self) -> int: ...
    @property
    def fluid(self) -> int: ...
    @property
    def longest_fluid(self) -> float: ...
    @property
    def deferred(self) -> int: ...

def predict_states(
    R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    v: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    duration: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gravity_s: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gravity_s2: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    by_bias: Annotated[NDArray[numpy.float64], dict(shape=(None, 9, 6), order="C", device="cpu", writable=False)],
    change: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order="C", device="cpu", writable=False)],
    X: Annotated[NDArray[numpy.float64], dict(shape=(None, 5, 5), order="C", device="cpu", writable=False)],
    gravity: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]: ...
def motion_measurements(
    stamps_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gyro: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    accel: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    starts_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ends_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    v: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    duration: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gravity_s: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gravity_s2: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gyro_bias: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    accel_bias: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    by_bias: Annotated[NDArray[numpy.float64], dict(shape=(None, 9, 6), order="C", device="cpu", writable=False)],
    covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, 9, 9), order="C", device="cpu", writable=False)],
    model: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gravity: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    share: float,
    keep_samples: bool,
) -> tuple[Any, ...]: ...
def propagate(
    stamps_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gyro: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    accel: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    t0_ns: int,
    t1_ns: int,
    R_odom_imu: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order="C", device="cpu", writable=False)],
    vectors: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    g_basis: Annotated[NDArray[numpy.float64], dict(shape=(3, 2), order="C", device="cpu", writable=False)],
    model: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def preintegrate(
    stamps_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gyro: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    accel: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    starts_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ends_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    biases: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order="C", device="cpu", writable=False)],
    model: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...
def decode_points(
    x: object, y: object, z: object, time: object | None, intensity: object | None, ring: object | None
) -> tuple[Any, ...]: ...
def sweep_offsets(
    times: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    first: float,
    ns_per_unit: float,
    longest_ns: float,
) -> tuple[Any, ...]: ...

class KdTree:
    def __init__(
        self, points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)]
    ) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def nearest(
        self,
        queries: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        count: int,
        max_distance: float,
    ) -> tuple[Any, ...]: ...

class SeenCubes:
    def __init__(self, edge: float) -> None: ...
    def __len__(self) -> int: ...
    def prune(
        self,
        centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
        radius: float,
    ) -> None: ...
    def clear(self) -> None: ...

class IncrementalKdTree:
    def __init__(self, spacing: float, balance: float) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def depth(self) -> int: ...
    def clear(self) -> None: ...
    def points(self) -> NDArray[numpy.float32]: ...
    def insert(
        self, points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)]
    ) -> int: ...
    def insert_scan(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        seen: SeenCubes,
    ) -> float: ...
    def forget_unseen(self, seen: SeenCubes, insertions: int) -> None: ...
    def remove_box(
        self,
        low: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
        high: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    ) -> int: ...
    def remove_beyond(
        self,
        centre: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
        radius: float,
    ) -> int: ...
    def nearest(
        self,
        queries: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        count: int,
        max_distance: float,
    ) -> tuple[Any, ...]: ...
    def planes(
        self,
        queries: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        neighbours: int,
        reach: float,
        max_thickness: float,
        min_spread: float,
        gate: float,
        threads: int,
    ) -> tuple[Any, ...]: ...

def so3_exp(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def so3_log(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def so3_left_jacobian(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def so3_right_jacobian(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def so3_left_jacobian_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def so3_right_jacobian_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_exp(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_log(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_adjoint(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_right_jacobian(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_right_jacobian_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_exp(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_log(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_adjoint(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_right_jacobian(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_right_jacobian_inverse(
    batch: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se2_compose(
    a: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    b: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...
def se3_compose(
    a: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    b: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(order="C", device="cpu")],
) -> None: ...

class VoxelMap:
    def __init__(
        self,
        voxel: float,
        levels: int,
        min_points: int,
        max_points: int,
        max_thickness: float,
        min_spread: float,
        point_spacing: float,
    ) -> None: ...
    def insert(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    ) -> float: ...
    def prune(
        self,
        centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
        radius: float,
        max_voxels: int,
    ) -> None: ...
    def forget_unseen(self, insertions: int) -> None: ...
    def save(self) -> bytes: ...
    def load(self, state: bytes) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def planes(self) -> NDArray[numpy.float64]: ...

def match_planes(
    map: VoxelMap,
    points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    before_end: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_odom_body_first: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    gate: float,
    kernel: float,
    sigma: float,
    fallback_stride: int,
    fallback_range: float,
    motion: bool,
    mounting: bool,
    threads: int,
) -> tuple[Any, ...]: ...
def match_points(
    map: VoxelMap,
    points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    before_end: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_odom_body_first: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    gate: float,
    kernel: float,
    sigma: float,
    motion: bool,
    mounting: bool,
    threads: int,
) -> tuple[Any, ...]: ...
def query_planes(
    map: VoxelMap,
    points_odom: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    gate: float,
    fallback_stride: int,
    fallback_range: float,
) -> tuple[Any, ...]: ...

class Scene:
    def __init__(
        self,
        packed: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order="C", device="cpu", writable=False)],
        shapes: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def __len__(self) -> int: ...
    def cast(
        self,
        directions: NDArray[numpy.float64],
        T_world_sensor: NDArray[numpy.float64],
        min_range: float,
        max_range: float,
        threads: int,
    ) -> tuple[NDArray[numpy.float64], NDArray[numpy.float32], NDArray[numpy.int32]]: ...
