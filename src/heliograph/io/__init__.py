"""Recordings in, results out: readers, what they infer about the data, and writers."""

from heliograph.data import Source
from heliograph.io.bags.live import LiveScans, cloud_of_array, cloud_of_message, sample_of_message
from heliograph.io.files.clouds import read_cloud, write_cloud
from heliograph.io.files.extrinsic import read_extrinsic, write_extrinsic
from heliograph.io.files.tum import read_tum, write_tum
from heliograph.io.inference.record import Inference
from heliograph.io.info import InfoReport, inspect_recording
from heliograph.io.prefetch import prefetch
from heliograph.io.recording import Recording, open_recording
from heliograph.io.registry import OPENERS, Opener, reader_names, register_reader

__all__ = [
    "OPENERS",
    "Inference",
    "InfoReport",
    "LiveScans",
    "Opener",
    "Recording",
    "Source",
    "cloud_of_array",
    "cloud_of_message",
    "inspect_recording",
    "open_recording",
    "prefetch",
    "read_cloud",
    "read_extrinsic",
    "read_tum",
    "reader_names",
    "register_reader",
    "sample_of_message",
    "write_cloud",
    "write_extrinsic",
    "write_tum",
]
