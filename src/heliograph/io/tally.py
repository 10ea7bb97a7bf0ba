"""Keeps the streams in order and counts what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, field

from heliograph.data import Event

__all__ = ["StreamTally", "Watch"]

LATE_NS = 100_000_000


@dataclass(slots=True)
class Watch:
    """Follows the stamps of one topic.

    Parameters
    ----------
    name : str
        ``"lidar"``, ``"imu"`` or ``"gnss"``.
    period_ns : int
        Expected step [ns]; a step of more than ``patience`` of them is a gap.
    patience : float
        See above.
    """

    name: str
    period_ns: int
    patience: float
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    duplicates: int = 0
    rewinds: int = 0
    late: int = 0
    bad: int = 0
    empty: int = 0
    unordered: int = 0
    gaps: list[tuple[int, int]] = field(default_factory=list)
    _lag_ns: int | None = None

    def accept(self, stamp_ns: int, received_ns: int) -> bool:
        """Count a message; False where its stamp does not advance and it must be dropped."""
        if self.count and stamp_ns <= self.last_ns:
            if stamp_ns == self.last_ns:
                self.duplicates += 1
            else:
                self.rewinds += 1
            return False
        lag = received_ns - stamp_ns
        # Late means: held back noticeably longer than the quickest message so far; clocks may differ by a constant.
        self._lag_ns = lag if self._lag_ns is None else min(self._lag_ns, lag)
        if lag - self._lag_ns > LATE_NS + self.period_ns:
            self.late += 1
        if self.count == 0:
            self.first_ns = stamp_ns
        elif stamp_ns - self.last_ns > self.patience * self.period_ns:
            self.gaps.append((self.last_ns, stamp_ns - self.last_ns))
        self.count += 1
        self.last_ns = stamp_ns
        return True

    @property
    def rate(self) -> float:
        """Messages a second over the whole stream [Hz]; 0 for fewer than two."""
        span = self.last_ns - self.first_ns
        return (self.count - 1) * 1e9 / span if self.count > 1 and span > 0 else 0.0

    def summary(self) -> dict[str, object]:
        """Return the counts as plain values."""
        return {
            "count": self.count,
            "rate_hz": round(self.rate, 4),
            "duration_s": (self.last_ns - self.first_ns) / 1e9,
            "gaps": len(self.gaps),
            "longest_gap_s": max((g for _, g in self.gaps), default=0) / 1e9,
            "duplicates": self.duplicates,
            "rewinds": self.rewinds,
            "late": self.late,
            "unordered": self.unordered,
            "unusable": self.bad,
            "empty": self.empty,
        }

    def events(self) -> list[Event]:
        """Return one warning for each kind of trouble."""
        found = []
        if self.gaps:
            at, longest = max(self.gaps, key=lambda g: g[1])
            message = (
                f"{self.name}: {len(self.gaps)} gaps of more than {self.patience:g} periods, the longest "
                f"{longest / 1e9:.3f} s; the motion "
                "across them is carried by the other sensor or the motion model"
            )
            found.append(Event(code=f"{self.name}-gap", message=message, stamp_ns=at, count=len(self.gaps)))
        troubles = (
            (self.duplicates, "duplicate", "messages repeat the stamp before them and are dropped"),
            (
                self.rewinds,
                "rewind",
                "messages have an earlier stamp than one before them and are dropped; check the recorder's clock",
            ),
            (
                self.late,
                "late",
                f"messages came over {LATE_NS // 1_000_000} ms later than others; they are used in order of arrival",
            ),
            (self.unordered, "unordered", "samples came behind a later one and are sorted in"),
            (self.bad, "bad", "messages hold values that are not finite or cannot be used, and are dropped"),
            (self.empty, "empty", "scans hold no valid point; motion is predicted across them"),
        )
        for count, code, text in troubles:
            if count:
                severity = "info" if code == "unordered" else "warning"
                message = f"{self.name}: {count} {text}"
                found.append(Event(code=f"{self.name}-{code}", message=message, count=count, severity=severity))
        return found


@dataclass(slots=True)
class StreamTally:
    """The watches of a recording's sensors."""

    lidar: Watch
    imu: Watch
    gnss: Watch
    points: int = 0
    valid_fixes: int = 0

    @classmethod
    def expecting(cls, scan_period_ns: int, imu_period_ns: int) -> StreamTally:
        """Return a tally for these periods."""
        return cls(
            Watch("lidar", scan_period_ns, 1.6),
            Watch("imu", imu_period_ns, 4.0 if imu_period_ns < 50_000_000 else 1.6),
            Watch("gnss", 1_000_000_000, 5.0),
        )

    def events(self) -> list[Event]:
        """Return the warnings of all sensors."""
        return [*self.lidar.events(), *self.imu.events(), *self.gnss.events()]
