"""Limits of the failure checks."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["CheckConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckConfig:
    """`heliograph check`: from where on a finding warns or fails.

    Parameters
    ----------
    min_rate, good_rate : float
        A lower rate of the IMU fails, warns [Hz].
    max_gap : float
        A longer pause of the IMU fails [s].
    warn_missing, max_missing : float
        Share of missing samples above which their count warns, fails.
    max_jitter : float
        Half the distance from the 5th to the 95th percentile of the samples' steps above which it warns [periods].
    max_drift_ppm : float
        Drift of the IMU's clock against the recorder's above which it warns [1e-6].
    warn_offset, max_offset : float
        Offset of the clocks of IMU and LiDAR above which it warns, fails [s].
    warn_mounting_deg, max_mounting_deg : float
        Error of the mounting above which it warns, fails [deg].
    warn_lever_arm, max_lever_arm : float
        Error of the lever arm above which it warns, fails [m].
    max_accel_scale, max_gyro_scale : float
        Relative error of a sensor's scale above which it warns.
    warn_vibration_accel, max_vibration_accel : float
        Root mean square of the specific force above 15 Hz beyond which it warns, fails [m/s^2].
    warn_vibration_gyro, max_vibration_gyro : float
        The same of the angular rate [rad/s].
    max_blind_growth : float
        One-sigma of the position that a stretch along which one direction is not seen may cost; more, and a run is
        called degraded [m].
    warn_thickness, max_thickness : float
        Standard deviation across clean walls of a run's map above which it warns, fails [m].
    warn_accel_bias, max_accel_bias : float
        Bias of the accelerometer that a run ends with above which it warns, fails [m/s^2].
    warn_gyro_bias, max_gyro_bias : float
        The same of the gyroscope [rad/s].
    warn_level_deg : float
        One-sigma of the level of a run above which it warns [deg].
    warn_drift : float
        Drift that loops show above which it warns [m per 100 m].
    max_revoked_share : float
        Share of the closed loops that were taken back above which it warns.
    """

    min_rate: float = 5.0
    good_rate: float = 90.0
    max_gap: float = 0.5
    warn_missing: float = 0.005
    max_missing: float = 0.1
    max_jitter: float = 0.3
    max_drift_ppm: float = 200.0
    warn_offset: float = 0.015
    max_offset: float = 0.2
    warn_mounting_deg: float = 3.0
    max_mounting_deg: float = 15.0
    warn_lever_arm: float = 0.15
    max_lever_arm: float = 0.3
    max_accel_scale: float = 0.05
    max_gyro_scale: float = 0.05
    warn_vibration_accel: float = 2.0
    max_vibration_accel: float = 10.0
    warn_vibration_gyro: float = 0.15
    max_vibration_gyro: float = 0.75
    max_blind_growth: float = 0.1
    warn_thickness: float = 0.05
    max_thickness: float = 0.12
    warn_accel_bias: float = 0.8
    max_accel_bias: float = 2.5
    warn_gyro_bias: float = 0.1
    max_gyro_bias: float = 0.5
    warn_level_deg: float = 1.0
    warn_drift: float = 1.5
    max_revoked_share: float = 0.2

    def __post_init__(self) -> None:
        check_range(self, "min_rate", "good_rate", "max_gap", "max_jitter", "max_drift_ppm", above=0.0)
        check_range(self, "warn_missing", "max_missing", low=0.0, high=1.0)
        check_range(self, "warn_offset", "max_offset", "max_accel_scale", "max_gyro_scale", above=0.0)
        check_range(self, "warn_mounting_deg", "max_mounting_deg", above=0.0, high=180.0)
        check_range(self, "warn_lever_arm", "max_lever_arm", above=0.0)
        check_range(self, "warn_vibration_accel", "max_vibration_accel", above=0.0)
        check_range(self, "warn_vibration_gyro", "max_vibration_gyro", above=0.0)
        check_range(self, "warn_thickness", "max_thickness", "warn_accel_bias", "max_accel_bias", above=0.0)
        check_range(self, "warn_gyro_bias", "max_gyro_bias", "warn_level_deg", "warn_drift", above=0.0)
        check_range(self, "max_revoked_share", low=0.0, high=1.0)
