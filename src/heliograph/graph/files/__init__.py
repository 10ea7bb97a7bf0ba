"""Graphs on disk, in the formats of the field and in our own; graphs to measure with."""
