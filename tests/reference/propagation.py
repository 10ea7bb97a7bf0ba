"""Slow, obvious twin of the native inertial propagation: one step at a time, matrix exponentials by their series."""

from itertools import pairwise

import numpy as np
from scipy.linalg import expm

GRAVITY_COLUMNS = slice(15, 17)


def hat(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def coasted(stamps_ns, t0, t1, config):
    """The stretches that are too far from any sample: before the first, in gaps, after the last."""
    hold, far = int(1e9 * config.hold), 10**19
    ends = [t0 - far, *(int(t) for t in stamps_ns), t1 + far]
    gaps = [(a, b) for a, b in pairwise(ends) if b - a > int(1e9 * config.max_gap)]
    return [(a + hold, b - hold) for a, b in gaps if a + hold < b - hold]


def time_grid(stamps_ns, t0, t1, config):
    """Start, samples inside, where coasting begins and ends, end; what is longer than a step and a quarter is divided
    into equal parts, but not what is coasted through."""
    coasts = coasted(stamps_ns, t0, t1, config)
    knots = sorted({t0, t1, *(int(t) for t in (*stamps_ns, *(t for pair in coasts for t in pair)) if t0 < t < t1)})
    grid = [t0]
    for a, b in pairwise(knots):
        parts = 1
        if not any(left <= a and b <= right for left, right in coasts):
            while (b - a) > (parts + 0.25) * config.max_step * 1e9:
                parts += 1
        grid += [a + (b - a) * k // parts for k in range(1, parts + 1)]
    return np.array(grid, dtype=np.int64)


def propagate_slowly(imu, state, end_ns, *, noise, config, g_basis):
    """Return stamps, rotations, positions, velocities, transition (17, 17), noise (17, 17), held seconds."""
    grid = time_grid(imu.stamps_ns, state.stamp_ns, end_ns, config)
    R, p, v = state.R_odom_imu, state.p_odom, state.v_odom
    path, transition, added, held_s = [(R, p, v)], np.eye(17), np.zeros((17, 17)), 0.0
    for a, b in pairwise(grid):
        dt, middle = 1e-9 * float(b - a), int(a) + (int(b) - int(a)) // 2
        gyro, accel, distance = signal(imu, middle, config)
        w, f = gyro - state.gyro_bias, accel - state.accel_bias
        held, gyro_var, accel_var = densities(imu, middle, noise, config)
        F = step_transition(R, w, f, dt, g_basis)
        if held and distance > config.hold:  # it coasts, whatever its heading, biases and gravity are
            w, f, F = np.zeros(3), -R.T @ state.g_odom, np.eye(17)
            F[3:6, 6:9] = dt * np.eye(3)
        transition, added = F @ transition, F @ added @ F.T + step_noise(gyro_var, accel_var, noise, dt)
        held_s += dt if held else 0.0
        acceleration = R @ expm(hat(0.5 * dt * w)) @ f + state.g_odom
        p, v, R = p + v * dt + 0.5 * acceleration * dt**2, v + acceleration * dt, R @ expm(hat(dt * w))
        path.append((R, p, v))
    return grid, *(np.stack(column) for column in zip(*path, strict=True)), transition, added, held_s


def signal(imu, t, config):
    """Rate and force at t, interpolated, but in gaps and outside the nearest sample's; and how far that is [s]."""
    nearest = int(np.argmin(np.abs(imu.stamps_ns - t)))
    distance = 1e-9 * abs(float(imu.stamps_ns[nearest] - t))
    j = int(np.searchsorted(imu.stamps_ns, t, side="right"))
    if 0 < j < len(imu.stamps_ns) and imu.stamps_ns[j] - imu.stamps_ns[j - 1] <= int(1e9 * config.max_gap):
        s = float(t - imu.stamps_ns[j - 1]) / float(imu.stamps_ns[j] - imu.stamps_ns[j - 1])
        gyro, accel = ((1.0 - s) * x[j - 1] + s * x[j] for x in (imu.gyro, imu.accel))
        return gyro, accel, distance
    return imu.gyro[nearest], imu.accel[nearest], distance


def densities(imu, t, noise, config):
    """Whether t is held, and the variances of the white noise there with what interpolation may miss."""
    gyro_var, accel_var = noise.gyro**2, noise.accel**2
    j = int(np.searchsorted(imu.stamps_ns, t, side="right"))
    held = j in (0, len(imu.stamps_ns))
    if not held:
        period = 1e-9 * float(imu.stamps_ns[j] - imu.stamps_ns[j - 1])
        missed = config.curvature**2 * period / 3.0
        gyro_var += missed * ((imu.gyro[j] - imu.gyro[j - 1]) ** 2).sum()
        accel_var += missed * ((imu.accel[j] - imu.accel[j - 1]) ** 2).sum()
        held = period > config.max_gap
    if held:
        gyro_var, accel_var = gyro_var + config.held_gyro_noise**2, accel_var + config.held_accel_noise**2
    return held, gyro_var, accel_var


def step_transition(R, w, f, dt, g_basis):
    """Derivative of one step by the errors before it, from the chain rule with matrix exponentials."""
    half = expm(hat(0.5 * dt * w))
    # A small turn before the step turns the force too: R exp(e) half f; one of the bias turns half a step of it.
    by_rotation = -R @ hat(half @ f)
    by_gyro_bias = R @ half @ hat(f) @ right_jacobian(0.5 * dt * w) * (0.5 * dt)
    F = np.eye(17)
    F[0:3, 0:3] = expm(hat(dt * w)).T
    F[0:3, 9:12] = -right_jacobian(dt * w) * dt
    for rows, factor in ((slice(3, 6), 0.5 * dt**2), (slice(6, 9), dt)):
        F[rows, 0:3] = factor * by_rotation
        F[rows, 9:12] = factor * by_gyro_bias
        F[rows, 12:15] = -factor * R @ half
        F[rows, GRAVITY_COLUMNS] = factor * g_basis
    F[3:6, 6:9] = dt * np.eye(3)
    return F


def right_jacobian(phi):
    """Sum of the series (-hat)^k / (k + 1)!"""
    J, term = np.zeros((3, 3)), np.eye(3)
    for k in range(30):
        J, term = J + term, term @ -hat(phi) / (k + 2)
    return J


def step_noise(gyro_var, accel_var, noise, dt):
    """White acceleration integrated once and twice; white rate; the walks of the biases."""
    Q = np.zeros((17, 17))
    for i in range(3):
        Q[i, i] = gyro_var * dt
        Q[3 + i, 3 + i] = accel_var * dt**3 / 3.0
        Q[6 + i, 6 + i] = accel_var * dt
        Q[3 + i, 6 + i] = Q[6 + i, 3 + i] = accel_var * dt**2 / 2.0
        Q[9 + i, 9 + i] = noise.gyro_walk**2 * dt
        Q[12 + i, 12 + i] = noise.accel_walk**2 * dt
    return Q
