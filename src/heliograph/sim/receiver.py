"""A satellite receiver with good and bad spells: parameters, and what it measures along a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, Stamps, freeze
from heliograph.config_checks import check_choice, check_range
from heliograph.data import GnssFix
from heliograph.geodesy import enu_to_geodetic

__all__ = ["GnssModel", "GnssSpell", "ReceiverLog"]

_KINDS = ("outage", "multipath", "jump", "frozen", "degraded")
_WANDER = 0.1  # by which share the offset of multipath wanders, one-sigma
_CLEAR = 0.08  # no drawn spell lies in this share of the recording's beginning and end


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssSpell:
    """A stretch of time in which the receiver is not what it says.

    Parameters
    ----------
    kind : str
        ``"outage"``: no fix. ``"multipath"``: the position is off by about `size`, in one direction that wanders.
        ``"jump"``: off by exactly `size`. ``"frozen"``: the first position of the spell is repeated. ``"degraded"``: a
        float solution, its one-sigma noise is `size` and reported so.
    duration : float
        [s].
    size : float
        See above [m].
    start : float
        Since the recording's first instant [s]; negative: drawn by the seed, so that drawn spells do not overlap.
    """

    kind: str = "outage"
    duration: float = 10.0
    size: float = 0.0
    start: float = -1.0

    def __post_init__(self) -> None:
        check_choice(self, "kind", *_KINDS)


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssModel:
    """A GNSS receiver; it has a fix where nothing is above it.

    Parameters
    ----------
    rate : float
        Fixes a second [Hz]; 0 leaves the receiver out.
    noise_horizontal, noise_vertical : float
        One-sigma of the position, white [m].
    origin_deg : (float, float)
        Latitude and longitude of the world's origin [deg].
    origin_height : float
        Its height above the ellipsoid [m].
    antenna : (float, float, float)
        Where the antenna sits on the walking body, whose origin is the IMU's: forward, left, up [m].
    solution : str
        What the receiver says of its fixes: ``"single"``, ``"sbas"``, ``"float"`` or ``"fixed"``.
    reported_scale : float
        The one-sigma that it reports, as a multiple of the true one.
    bias_sigma, bias_time : float
        A slowly changing error of this one-sigma [m] and correlation time [s], not reported.
    delay : float
        How much later than the truth fixes are stamped [s].
    latency : float
        How long after its instant a fix arrives [s].
    spells : tuple of GnssSpell
    """

    rate: float = 2.0
    noise_horizontal: float = 0.5
    noise_vertical: float = 1.0
    origin_deg: tuple[float, float] = (52.0, 11.0)
    origin_height: float = 80.0
    antenna: tuple[float, float, float] = (0.0, 0.0, 0.0)
    solution: str = "single"
    reported_scale: float = 1.0
    bias_sigma: float = 0.0
    bias_time: float = 60.0
    delay: float = 0.0
    latency: float = 0.0
    spells: tuple[GnssSpell, ...] = ()

    def __post_init__(self) -> None:
        check_range(self, "rate", low=0.0, high=1000.0)
        check_range(self, "noise_horizontal", "noise_vertical", "reported_scale", "bias_sigma", low=0.0, high=1e6)
        check_range(self, "bias_time", low=1e-3, high=1e9)
        check_range(self, "delay", "latency", low=-1e3, high=1e3)
        check_choice(self, "solution", "single", "sbas", "float", "fixed")

    @property
    def origin(self) -> Array:
        """Latitude [rad], longitude [rad] and height [m] of the world's origin, (3,)."""
        return np.array([*np.radians(self.origin_deg), self.origin_height])


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverLog:
    """What a receiver measured, and what was wrong with it.

    Parameters
    ----------
    model : GnssModel
    stamps_ns : (N,) int64
        True instants [ns].
    p_enu : (N, 3) float64
        Measured, about the world's origin [m].
    truth_enu : (N, 3) float64
        Where the antenna was [m].
    sigma_enu : (N, 3) float64
        Reported one-sigma [m].
    valid : (N,) bool
        Whether there is a fix.
    kinds : (N,) int64
        0 for a sound fix, else 1 in an outage, 2 in multipath, 3 in a jump, 4 where frozen, 5 where degraded.
    """

    model: GnssModel
    stamps_ns: Stamps
    p_enu: Array
    truth_enu: Array
    sigma_enu: Array
    valid: Mask
    kinds: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def bad(self) -> Mask:
        """Fixes (N,) of spells in which the receiver is wrong without saying so."""
        return np.isin(self.kinds, [1 + _KINDS.index(kind) for kind in ("multipath", "jump", "frozen")])

    @classmethod
    def draw(
        cls, model: GnssModel, stamps_ns: Stamps, truth_enu: Array, covered: Mask, rng: np.random.Generator
    ) -> ReceiverLog:
        """Measure along a motion.

        Parameters
        ----------
        model : GnssModel
        stamps_ns : (N,) int64
            Increasing [ns].
        truth_enu : (N, 3) float64
            Where the antenna is [m].
        covered : (N,) bool
            Where something is above it.
        rng : Generator
        """
        n = len(stamps_ns)
        usual = np.array([model.noise_horizontal, model.noise_horizontal, model.noise_vertical])
        sigma, white = np.tile(usual, (n, 1)), rng.standard_normal((n, 3))
        offset = _bias(model, n, rng)
        valid, kinds = ~covered, np.zeros(n, dtype=np.int64)
        seconds = 1e-9 * (stamps_ns - stamps_ns[0]) if n else np.zeros(0)
        frozen = []
        for spell, inside in _placed(model.spells, seconds, rng):
            kinds[inside] = 1 + _KINDS.index(spell.kind)
            offset[inside] += _offsets(spell, int(inside.sum()), rng)
            if spell.kind == "outage":
                valid = valid & ~inside
            if spell.kind == "degraded":
                sigma[inside] = spell.size
            frozen += [inside] if spell.kind == "frozen" and inside.any() else []
        p = truth_enu + sigma * white + offset
        for inside in frozen:
            first = np.flatnonzero(inside)[0]
            p[inside], kinds[first] = p[first], 0  # the first was measured
        return cls(
            model=model, stamps_ns=stamps_ns, p_enu=p, truth_enu=truth_enu, sigma_enu=sigma * model.reported_scale,
            valid=valid, kinds=kinds,
        )  # fmt: skip

    def fixes(self) -> Iterator[GnssFix]:
        """Yield the fixes in the order of their arrival."""
        model = self.model
        geodetic = enu_to_geodetic(self.p_enu, model.origin)
        delay, latency = round(1e9 * model.delay), round(1e9 * model.latency)
        degraded = 1 + _KINDS.index("degraded")
        for stamp, (latitude, longitude, height), sigma, valid, kind in zip(
            self.stamps_ns.tolist(), geodetic, self.sigma_enu, self.valid, self.kinds, strict=True
        ):
            yield GnssFix(
                stamp_ns=stamp + delay,
                received_ns=stamp + max(latency, delay),
                latitude_deg=float(np.degrees(latitude)),
                longitude_deg=float(np.degrees(longitude)),
                altitude=float(height),
                covariance_enu=np.diag(sigma**2),
                valid=bool(valid),
                solution="float" if kind == degraded else model.solution,
            )


def _bias(model: GnssModel, count: int, rng: np.random.Generator) -> Array:
    """Return a first-order Gauss-Markov error (N, 3)."""
    bias = np.zeros((count, 3))
    if model.bias_sigma <= 0.0 or count == 0:
        return bias
    keep = float(np.exp(-1.0 / (model.rate * model.bias_time)))
    steps = model.bias_sigma * rng.standard_normal((count, 3))
    bias[0] = steps[0]
    for k in range(1, count):
        bias[k] = keep * bias[k - 1] + np.sqrt(1.0 - keep**2) * steps[k]
    return bias


def _placed(
    spells: tuple[GnssSpell, ...], seconds: Array, rng: np.random.Generator
) -> Iterator[tuple[GnssSpell, Mask]]:
    """Yield the spells with the fixes in them; those without a start share what is left of the recording at random."""
    drawn = [k for k, spell in enumerate(spells) if spell.start < 0.0]
    length = float(seconds[-1]) if len(seconds) else 0.0
    free = max((1.0 - 2.0 * _CLEAR) * length - sum(spells[k].duration for k in drawn), 0.0)
    gaps = free * rng.dirichlet(np.ones(len(drawn) + 1)) if drawn else np.zeros(1)
    order = rng.permutation(len(drawn)) if drawn else np.zeros(0, dtype=np.int64)
    starts, at = {}, _CLEAR * length
    for k, gap in zip(order.tolist(), gaps, strict=False):
        at += float(gap)
        starts[drawn[k]] = at
        at += spells[drawn[k]].duration
    for k, spell in enumerate(spells):
        start = starts.get(k, spell.start)
        yield spell, (seconds >= start) & (seconds < start + spell.duration)


def _offsets(spell: GnssSpell, count: int, rng: np.random.Generator) -> Array:
    """Return what a spell adds to its fixes, (count, 3): mostly level, as reflections are."""
    if spell.kind not in ("multipath", "jump"):
        return np.zeros((count, 3))
    heading = rng.uniform(0.0, 2.0 * np.pi)
    toward = np.array([np.cos(heading), np.sin(heading), 0.5 * rng.standard_normal()])
    offset = np.tile(spell.size * toward / np.linalg.norm(toward), (count, 1))
    if spell.kind == "multipath":
        wander = np.cumsum(rng.standard_normal((count, 3)), axis=0) / max(np.sqrt(count), 1.0)
        offset += _WANDER * spell.size * wander
    return offset
