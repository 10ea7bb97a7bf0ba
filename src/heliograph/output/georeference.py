"""What ``run.json`` and the closing lines say of where the map lies on Earth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from heliograph.arrays import Array
from heliograph.data import GnssAccount

__all__ = ["gnss_facts", "gnss_sentence"]


def gnss_facts(account: GnssAccount) -> dict[str, Any]:
    """Return the account of the fixes, as ``run.json`` has it."""
    told = math.isfinite(account.delay_sigma)
    facts: dict[str, Any] = {
        "sentence": gnss_sentence(account),
        "fixes": {"total": len(account.fixes), **account.counts},
        "lever_arm_imu": account.lever_arm.tolist(),
        "lever_arm_sigma": account.lever_arm_sigma.tolist(),
        "delay_s": account.delay,
        "delay_sigma_s": account.delay_sigma if told else None,
        "noise_scale": account.noise_scale,
        "odometry_scale": account.odometry_scale,
    }
    reference = account.georeference
    if reference is None:
        return {"aligned": False, "reason": account.reason, **facts}
    rms = _rms(account)
    return {
        "aligned": True,
        **facts,
        "origin": {
            "latitude_deg": float(reference.origin_deg[0]),
            "longitude_deg": float(reference.origin_deg[1]),
            "height_ellipsoid_m": float(reference.origin_deg[2]),
        },
        "T_map_enu": reference.T_map_enu.tolist(),
        "heading_sigma_deg": math.degrees(reference.heading_sigma),
        "origin_sigma_m": np.sqrt(np.diag(reference.covariance)[3:]).tolist(),
        "residual_rms_enu_m": rms.tolist(),
    }


def gnss_sentence(account: GnssAccount) -> str:
    """Return what the fixes came to, in one line."""
    used, total = account.counts.get("used", 0), len(account.fixes)
    reference = account.georeference
    if account.counts.get("unusable", 0) == total:
        return f"gnss: none of {total} messages holds a fix that can be used"
    if reference is None:
        return f"gnss: CANNOT ALIGN, {total} fixes are not used: {account.reason}"
    east, north, up = _rms(account)
    rejected = account.counts.get("rejected", 0)
    return (
        f"gnss: {used} of {total} fixes used, {rejected} rejected; residuals {math.hypot(east, north):.3f} m level, "
        f"{up:.3f} m up; heading known to {math.degrees(reference.heading_sigma):.3f} deg"
    )


def _rms(account: GnssAccount) -> Array:
    rows = np.array([fix.residual_enu for fix in account.fixes if fix.decision == "used"]).reshape(-1, 3)
    return np.sqrt((rows**2).mean(axis=0)) if len(rows) else np.full(3, np.nan)
