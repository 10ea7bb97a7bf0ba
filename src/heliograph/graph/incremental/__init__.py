"""Smooth a graph that grows: iSAM2, its Bayes tree, fixed-lag smoothing and replay."""
