"""Fixes beside the back-end: they wait until the motion tells where the map lies, are judged, and become factors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Stamps, freeze
from heliograph.config import RunConfig
from heliograph.data import Event, Georeference, GnssAccount, GnssFix, JudgedFix
from heliograph.factors import AnchoredPosition
from heliograph.graph import ISAM2, Covariance, Diagonal, FactorGraph, Isotropic, Prior, Symbol, Values
from heliograph.lie import SE3
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.gnss.evidence import LEAST_WEIGHT, FixEvidence, Judgement, Placement
from heliograph.slam.gnss.intake import FixIntake
from heliograph.slam.gnss.judge import judge
from heliograph.slam.gnss.kept import KeptFixes
from heliograph.slam.gnss.track import OdometryTrack
from heliograph.snapshots import PART, Stateful, array

__all__ = ["FixesInForce", "GnssFactors"]

X, E, L = Symbol("X"), Symbol("E"), Symbol("L")
_FEWEST = 10  # fixes from which anything is told
_GROWTH = 1.5  # all fixes are judged anew when there are this many times more
_PLUMB = 1e-4  # by how much gravity may point beside the ellipsoid's normal [rad]
_LOOSE = (3.0, 1e4)  # sigmas of a heading and of an origin that nothing is known of [rad], [m]
_AGREEING = 0.75  # share of the fixes that must agree: of two camps of like size either may be the wrong one
_USUAL = 0.01  # share of sound fixes that the test may reject
_OPTIMISTIC = 1.5  # a receiver whose fixes are worse than it says by more is named
_CONVERGED = 1e-5  # an update with fixes goes on until no step is longer [rad], [m]
Loops = tuple[tuple[int, int, Array, Array], ...]


def judgement_events(judged: Judgement, stamps_ns: Stamps) -> list[Event]:
    """Return what a user should know of a judgement: rejected fixes, a receiver that claims too much, a delay."""
    events, total = [], len(judged.weights)
    rejected = np.flatnonzero(judged.placement.covered & ~judged.used)
    if len(rejected):
        off = float(np.linalg.norm(judged.residual[rejected], axis=1).max())
        message = (
            f"gnss: {len(rejected)} of {total} fixes contradict the odometry and the others, by up to {off:.1f} m: "
            "they are left out (gnss.csv lists them)"
        )
        severity = "warning" if len(rejected) > _USUAL * total else "info"
        first = int(stamps_ns[rejected[0]])
        events.append(
            Event(code="gnss-rejected", message=message, stamp_ns=first, severity=severity, count=len(rejected))
        )
    if judged.noise_scale > _OPTIMISTIC:
        message = (
            f"gnss: the fixes are {judged.noise_scale:.1f} times worse than the receiver says, noise and slow drift "
            "together; they are weighed by that"
        )
        events.append(Event(code="gnss-optimistic", message=message))
    if judged.delay:
        message = (
            f"gnss: the fixes are stamped {judged.delay:.3f} s late (one-sigma {judged.delay_sigma:.3f} s); "
            "it is taken out (--set gnss.correct_delay=false leaves it)"
        )
        events.append(Event(code="gnss-delay", message=message))
    return events


@dataclass(frozen=True, slots=True)
class FixesInForce:
    """What the smoother holds of the fixes: its numbers for them, and the judgement and fixes that they come from."""

    numbers: NDArray[np.int32]
    judgement: Judgement
    fixes: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)


class GnssFactors(Stateful):
    """Collects fixes, judges them when there are enough, and keeps the smoother's factors of them up to date.

    Parameters
    ----------
    config : RunConfig
    antenna_imu : (3,) float64, optional
        The antenna in the imu frame, where the recording tells it [m].
    """

    _STATE: ClassVar = {
        "intake": PART,
        "track": PART,
        "_due_at": int,
        "_judgement": (Judgement, None),
        "_judged": array(np.int64, None),
        "_in_force": (FixesInForce, None),
        "_inertial": bool,
        "_reason": str,
    }

    def __init__(self, config: RunConfig, antenna_imu: Array | None = None) -> None:
        self._config = config.gnss
        self._level_sigma = math.radians(config.slam.level_sigma_deg)
        self.intake, self.track = FixIntake(config.gnss), OdometryTrack()
        given = np.array(config.gnss.lever_arm) if config.gnss.lever_arm else antenna_imu
        self._arm = np.zeros(3) if given is None else np.asarray(given, dtype=np.float64)
        self._arm_sigma = config.gnss.lever_arm_sigma if given is None else 0.0
        self._due_at = _FEWEST
        self._judgement: Judgement | None = None
        self._judged: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._in_force: FixesInForce | None = None
        self._kept: KeptFixes | None = None
        self._inertial = True
        self._reason = "the recording holds no fix that can be used"

    @property
    def in_use(self) -> bool:
        """Whether fixes hold the map."""
        return self._in_force is not None or self._kept is not None

    def observe(self, fix: GnssFix) -> None:
        """Take a fix of the recording."""
        if self._config.use:
            self.intake.add(fix)

    def events(self) -> tuple[Event, ...]:
        """Return what a user should know of the fixes."""
        if not len(self.intake):
            return ()
        found = self.intake.events()
        if not self.in_use:
            message = f"gnss: CANNOT ALIGN, {len(self.intake)} fixes are not used: {self._reason}"
            if len(self.intake.usable):  # indoors, no receiver has a fix
                found.append(Event(code="gnss-cannot-align", message=message, severity="info", count=len(self.intake)))
        elif self._judgement is not None:
            found += judgement_events(self._judgement, self.intake.stamps_ns[self._judged])
        return tuple(found)

    def due(self) -> bool:
        """Whether enough fixes have come since the last time for all to be judged."""
        return len(self.intake) >= self._due_at and int((self._known()).size) >= self._due_at

    def enforce(self, smoother: ISAM2, chain: OdometryChain, loops: Loops, *, inertial: bool) -> bool:
        """Judge all fixes anew and bring what is believed into the smoother; return whether it changed.

        Parameters
        ----------
        smoother : ISAM2
            The smoother of the keyframes.
        chain : OdometryChain
        loops : tuple of (int, int, (4, 4), (6, 6))
            Those that stand: ``i, j, T_i_j`` and covariance.
        inertial : bool
            Whether the map's z axis points up.
        """
        known = self._known()
        self._due_at = max(_FEWEST, math.ceil(_GROWTH * len(known)))
        evidence = self._evidence(known, chain, loops, inertial=inertial)
        if evidence is None:
            return False
        self._judgement, self._judged = judge(evidence, self._config), known
        self._reason = self._why_not(self._judgement, chain)
        if self._reason:
            return self._withdraw(smoother)
        self._bring(smoother, self._judgement, known, inertial=inertial)
        return True

    def keep(self, smoother: ISAM2, kept: KeptFixes) -> None:
        """Bring in the fixes that the graph of a run that has ended kept, as they were judged then."""
        smoother.update(kept.graph, kept.values, iterate=_CONVERGED)
        self._kept = kept

    def factors(self) -> FactorGraph:
        """Return the factors in force, and the priors of the variables that they bring; for files."""
        graph = FactorGraph() if self._kept is None else self._kept.graph.copy()
        if self._in_force is not None:
            for group in self._graph(self._in_force.judgement, inertial=self._inertial).groups():
                graph.adopt(group)
        return graph

    def account(self, smoother: ISAM2, T_map_imu: Array) -> GnssAccount | None:
        """Return what became of the fixes; None where there were none.

        Parameters
        ----------
        smoother : ISAM2
        T_map_imu : (K, 4, 4) float64
            The keyframes.
        """
        if not len(self.intake):
            return None
        judged, reference, arm = self._judgement, None, self._arm
        if self._in_force is not None and self.intake.origin is not None:
            origin = np.array([*np.degrees(self.intake.origin[:2]), self.intake.origin[2]])
            T_map_enu = np.ascontiguousarray(smoother.estimate(E(0)).matrix)
            covariance = np.ascontiguousarray(smoother.covariance(E(0)))
            reference = Georeference(origin_deg=origin, T_map_enu=T_map_enu, covariance=covariance)
            arm = np.asarray(smoother.estimate(L(0))) if self._arm_sigma else self._arm
        return GnssAccount(
            fixes=tuple(self._rows(T_map_imu, reference, arm)),
            georeference=reference,
            reason="" if reference is not None else self._reason,
            lever_arm=arm,
            lever_arm_sigma=np.zeros(3) if judged is None else judged.arm_sigma,
            delay=0.0 if judged is None else judged.delay,
            delay_sigma=float("nan") if judged is None else judged.delay_sigma,
            noise_scale=1.0 if judged is None else judged.noise_scale,
            odometry_scale=1.0 if judged is None else judged.odometry_scale,
        )

    def _known(self) -> NDArray[np.int64]:
        """Return the numbers of usable fixes that lie within the odometry's way."""
        usable, stamps = self.intake.usable, self.intake.stamps_ns
        inside = (stamps[usable] >= self.track.first_ns) & (stamps[usable] <= self.track.last_ns)
        order = np.argsort(stamps[usable][inside], kind="stable")
        return np.asarray(usable[inside][order])

    def _evidence(
        self, known: NDArray[np.int64], chain: OdometryChain, loops: Loops, *, inertial: bool
    ) -> FixEvidence | None:
        if len(chain) < 2:
            self._reason = f"the run has {len(chain)} keyframe: it did not move"
            return None
        if len(known) < _FEWEST:
            self._reason = self._too_few(len(known))
            return None
        stamps = self.intake.stamps_ns[known]
        p, P = (array[known] for array in self.intake.positions())
        keyframes_ns, T_odom = chain.stamps_ns, chain.T_odom_imu

        def placed(delay: float) -> Placement:
            nearest, T, covered = self.track.at_keyframes(stamps - round(1e9 * delay), keyframes_ns, T_odom)
            return Placement(keyframe=nearest, T_keyframe_body=T, covered=covered)

        if int(placed(0.0).covered.sum()) < _FEWEST:
            self._reason = self._too_few(int(placed(0.0).covered.sum()))
            return None
        return FixEvidence(
            T_odom_imu=T_odom,
            step_covariances=chain.step_covariances,
            loops=loops,
            seconds=1e-9 * (stamps - stamps[0]),
            p_enu=p,
            covariance=P,
            solutions=np.array([self.intake.fixes[k].solution for k in known.tolist()]),
            placed=placed,
            arm=self._arm,
            arm_sigma=self._arm_sigma,
            level_sigma=self._level_sigma if inertial else math.inf,
        )

    def _too_few(self, count: int) -> str:
        usable = self.intake.usable
        if count == 0 and len(usable) >= _FEWEST and len(self.track):
            first, last = (int(self.intake.stamps_ns[usable[k]]) for k in (0, -1))
            apart = (first - self.track.last_ns, last - self.track.first_ns)
            if apart[0] > 0 or apart[1] < 0:
                late = 0.5 * (first + last - self.track.first_ns - self.track.last_ns) * 1e-9
                return f"none lies within the run: their clock shows about {late:+.0f} s more (gnss.clock_offset)"
        return f"{count} of {len(self.intake)} fixes can be used and lie within the run, {_FEWEST} are needed"

    def _why_not(self, judgement: Judgement, chain: OdometryChain) -> str:
        """Return why the map cannot be placed; empty where it can."""
        used = int(judgement.used.sum())
        sigma, allowed = math.degrees(judgement.heading_sigma), self._config.max_heading_sigma_deg
        compared = int(judgement.placement.covered.sum())
        if used < max(_FEWEST, _AGREEING * compared):
            return (
                f"{used} of {compared} fixes agree with each other and with the odometry, {compared - used} do not "
                f"({_AGREEING:.0%} must): check the receiver, its datum, and that file and recording are of one drive"
            )
        if sigma > allowed:
            p = chain.T_odom_imu[:, :2, 3]
            reach = float(np.linalg.norm(p - p[0], axis=1).max())
            noise = float(np.sqrt(np.median(judgement.covariance[judgement.used, 0, 0])))
            return (
                f"the way reaches {reach:.1f} m and the fixes are good to {noise:.2f} m: the heading is told to "
                f"{min(sigma, 180.0):.1f} deg, {allowed:g} deg are needed"
            )
        return ""

    def _bring(self, smoother: ISAM2, judgement: Judgement, known: NDArray[np.int64], *, inertial: bool) -> None:
        """Put the believed fixes into the smoother, in place of those before."""
        self._inertial = inertial
        first, values, gone = self._in_force is None, Values(), np.zeros(0, dtype=np.int32)
        if first:
            values.insert(E(0), SE3(np.ascontiguousarray(judgement.T_map_enu)))
            if self._arm_sigma:
                values.insert(L(0), judgement.arm)
        else:
            assert self._in_force is not None
            gone = self._in_force.numbers
        graph = self._graph(judgement, inertial=inertial)
        result = smoother.update(graph, values if first else None, remove=gone, iterate=_CONVERGED)
        self._in_force = FixesInForce(result.factors, judgement, known)

    def _withdraw(self, smoother: ISAM2) -> bool:
        """Take back what was brought in before all fixes together spoke against it; return whether anything was."""
        if self._in_force is None:
            return False
        frame = [int(E(0)), *([int(L(0))] if self._arm_sigma else [])]
        smoother.update(remove=self._in_force.numbers, remove_variables=frame, iterate=_CONVERGED)
        self._in_force = None
        return True

    def _graph(self, judgement: Judgement, *, inertial: bool) -> FactorGraph:
        """Return the priors of what is estimated, and a factor for each believed fix."""
        graph, used, placement = FactorGraph(), judgement.used, judgement.placement
        tilt = _PLUMB if inertial else _LOOSE[0]
        start = self._T_start(judgement)
        graph.add(Prior(E(0), SE3(start), Diagonal(np.array([tilt, tilt, _LOOSE[0], *[_LOOSE[1]] * 3]))))
        offset, arm = placement.points(judgement.arm), None
        if self._arm_sigma:
            offset, arm = offset - judgement.arm, L(0)
            graph.add(Prior(L(0), self._arm, Isotropic(self._arm_sigma)))
        P = judgement.covariance[used] / judgement.weights[used, None, None]
        p_enu = self.intake.positions()[0][self._judged[used]]
        keys = X(placement.keyframe[used])
        graph.add(AnchoredPosition(keys, E(0), p_enu, Covariance(P), offset=offset[used], arm_key=arm))
        return graph

    def _T_start(self, judgement: Judgement) -> Array:
        """Return a pose of east-north-up in the map whose z axis is the map's, where the fixes say nothing of it."""
        T = np.array(judgement.T_map_enu)
        c, s = T[0, 0], T[1, 0]
        size = math.hypot(c, s)
        T[:3, :3] = np.array([[c / size, -s / size, 0.0], [s / size, c / size, 0.0], [0.0, 0.0, 1.0]])
        return T

    def _rows(self, T_map_imu: Array, reference: Georeference | None, arm: Array) -> list[JudgedFix]:
        place = {int(k): n for n, k in enumerate(self._judged)}
        order = np.argsort(self.intake.stamps_ns, kind="stable").tolist()
        positions, covariances = self.intake.positions()
        residuals = self._residuals(T_map_imu, reference, arm, positions)
        rows = []
        for k in order:
            fix, reason, nan = self.intake.fixes[k], self.intake.refused[k], np.full(3, np.nan)
            weight, residual, P, decision = 0.0, nan, covariances[k], "unusable"
            if not reason:
                decision, reason = "not compared", "outside the odometry's way"
                judged = self._judgement
                if judged is not None and k in place:
                    n = place[k]
                    weight, P = float(judged.weights[n]), judged.covariance[n]
                    residual = residuals[n]
                    decision, reason = _told(judged, n, placed=reference is not None)
            rows.append(JudgedFix(
                stamp_ns=fix.stamp_ns,
                solution=fix.solution,
                geodetic_deg=np.array([fix.latitude_deg, fix.longitude_deg, fix.altitude]),
                p_enu=positions[k],
                sigma_enu=np.sqrt(np.diag(P)),
                residual_enu=residual,
                weight=weight if reference is not None else 0.0,
                decision=decision,
                reason=reason,
            ))  # fmt: skip
        return rows

    def _residuals(self, T_map_imu: Array, reference: Georeference | None, arm: Array, p_enu: Array) -> Array:
        """Return the residuals (M, 3) of the judged fixes by the graph, or by their own judgement where it has none."""
        judged = self._judgement
        if judged is None or reference is None or len(T_map_imu) <= int(judged.placement.keyframe.max(initial=0)):
            return np.zeros((0, 3)) if judged is None else judged.residual
        T = reference.T_enu_map @ T_map_imu[judged.placement.keyframe]
        local = judged.placement.points(judged.arm) + (arm - judged.arm)
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], local) + T[:, :3, 3] - p_enu[self._judged])


def _told(judged: Judgement, n: int, *, placed: bool) -> tuple[str, str]:
    """Return decision and reason of a fix that was compared."""
    if not judged.placement.covered[n]:
        return "not compared", "the odometry has no pose near it"
    off, allowed = float(np.linalg.norm(judged.residual[n])), math.sqrt(judged.threshold)
    sigmas = math.sqrt(float(judged.squared[n]))
    told = f"{off:.2f} m off, {sigmas:.1f} of its sigmas"
    if judged.weights[n] <= LEAST_WEIGHT:
        return "rejected", f"{told}, {allowed:.1f} allowed"
    return ("used", told) if placed else ("not compared", "the map could not be placed on Earth")
