"""The lesson's experiments in the browser, driven by the engine; `heliograph lab` opens them."""

from heliograph.lab.experiment import Chart, Control, Experiment, Reading, Trace, View
from heliograph.lab.experiments import EXPERIMENTS, find_experiment

__all__ = ["EXPERIMENTS", "Chart", "Control", "Experiment", "Reading", "Trace", "View", "find_experiment"]
