"""Recordings in, results out: readers, what they infer about the data, and writers."""

from heliograph.io.inference.record import Inference
from heliograph.io.info import InfoReport, inspect_recording
from heliograph.io.prefetch import prefetch
from heliograph.io.recording import Recording, open_recording

__all__ = ["Inference", "InfoReport", "Recording", "inspect_recording", "open_recording", "prefetch"]
