"""The lesson's experiments in the browser, driven by the engine; `heliograph lab` opens them."""

from heliograph.lab.experiment import Chart, ChartTrace, Control, Experiment, ExperimentView, Reading
from heliograph.lab.experiments import EXPERIMENTS, find_experiment

__all__ = [
    "EXPERIMENTS",
    "Chart",
    "ChartTrace",
    "Control",
    "Experiment",
    "ExperimentView",
    "Reading",
    "find_experiment",
]
