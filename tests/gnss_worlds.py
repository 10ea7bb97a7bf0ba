"""Surveys without clouds: a simulated way, an odometry that drifts along it as it says, and a receiver's fixes."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from heliograph.config import RunConfig
from heliograph.graph import ISAM2, Between, Covariance, FactorGraph, Symbol, Values
from heliograph.lie import SE3, se3
from heliograph.sim import SCENARIOS
from heliograph.sim.simulate import Simulation
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.gnss import GnssFactors

X = Symbol("X")


@dataclass(frozen=True)
class Survey:
    """Keyframes a metre apart, scans ten times a second, and fixes; the map begins at the first keyframe, turned."""

    simulation: Simulation
    log: object
    scans_ns: np.ndarray
    T_odom_scans: np.ndarray
    keyframes_ns: np.ndarray
    chain: OdometryChain
    T_world_keyframes: np.ndarray

    @property
    def antenna(self):
        return self.simulation.rig.antenna_imu


def survey(name, seed, *, rotation_deg=0.02, position=0.003, gnss=None, duration=None, step=1.0):
    """Return a survey of a scenario; the odometry's sigmas are those of a step of a keyframe."""
    scenario = SCENARIOS[name]
    scenario = scenario if gnss is None else replace(scenario, gnss=replace(scenario.gnss, **gnss))
    scenario = scenario if duration is None else replace(scenario, walk=replace(scenario.walk, duration=duration))
    simulation = Simulation(scenario, seed)
    rng = np.random.default_rng(1000 + seed)
    scans = simulation.imu_stamps_ns[20::20]
    T_world = simulation.truth.pose(scans)
    picked, last = [0], T_world[0]
    for k, T in enumerate(T_world):
        if np.linalg.norm(T[:3, 3] - last[:3, 3]) >= step:
            picked.append(k)
            last = T
    sigma = np.array([np.radians(rotation_deg)] * 3 + [position] * 3)
    T_true = T_world[picked]
    heading = se3.exp(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0), 0.0, 0.0, 0.0]))
    start = T_world[0].copy()
    start[:3, 3] = 0.0
    T_odom = [heading @ start]
    for before, after in pairwise(T_true):
        noise = se3.exp(sigma * rng.standard_normal(6))
        T_odom.append(T_odom[-1] @ se3.inverse(before) @ after @ noise)
    T_odom = np.stack(T_odom)
    chain = OdometryChain()
    for k, (stamp, T) in enumerate(zip(scans[picked].tolist(), T_odom, strict=True)):
        chain.append(stamp, T, np.diag(sigma**2) if k else np.zeros((6, 6)))
    of_scan = np.clip(np.searchsorted(picked, np.arange(len(scans)), side="right") - 1, 0, None)
    T_scans = T_odom[of_scan] @ se3.inverse(T_true[of_scan]) @ T_world
    return Survey(simulation, simulation.receiver(), scans, T_scans, scans[picked], chain, T_true)


def georeferenced(world, *, config=None, antenna="given", until=np.inf):
    """Return the fixes' collaborator and the smoother after a survey, as the back-end uses them."""
    fixes = GnssFactors(config or RunConfig(), world.antenna if antenna == "given" else antenna)
    for stamp, T in zip(world.scans_ns.tolist(), world.T_odom_scans, strict=True):
        fixes.track.append(stamp, T)
    for fix in world.log.fixes():
        if fix.stamp_ns <= world.log.stamps_ns[0] + 1e9 * until:
            fixes.observe(fix)
    smoother, graph, values = ISAM2(), FactorGraph(), Values()
    T, keys = world.chain.T_odom_imu, X(np.arange(len(world.chain)))
    values.insert(keys, SE3(T))
    graph.fix(keys[0])
    if len(T) > 1:
        steps = np.ascontiguousarray(se3.inverse(T[:-1]) @ T[1:])
        graph.add(Between(keys[:-1], keys[1:], SE3(steps), Covariance(world.chain.step_covariances[1:])))
    smoother.update(graph, values)
    fixes.enforce(smoother, world.chain, (), inertial=True)
    return fixes, smoother


def absolute_error(world, fixes, smoother):
    """Return the RMS distance of all keyframes from the truth on Earth, and of the heading [m], [deg]."""
    T_map_imu = smoother.estimate(X(np.arange(len(world.chain)))).matrix
    account = fixes.account(smoother, T_map_imu)
    model = world.log.model
    reference = account.georeference
    from heliograph.geodesy import geodetic_to_enu

    origin = geodetic_to_enu(
        np.array([[*np.radians(reference.origin_deg[:2]), reference.origin_deg[2]]]), model.origin
    )[0]
    T_enu = reference.T_enu_map @ T_map_imu
    off = T_enu[:, :3, 3] + origin - world.T_world_keyframes[:, :3, 3]
    turned = se3.log(se3.inverse(world.T_world_keyframes) @ T_enu)[:, 2]
    return float(np.sqrt((off**2).sum(axis=1).mean())), float(np.degrees(np.sqrt((turned**2).mean()))), account, off
