"""Solve a whole graph at once: the minimisers, where they begin, robust solving and marginals."""
