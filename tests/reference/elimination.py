"""Slow, obvious twins of the native orderings: sets of neighbours, one elimination at a time."""

import numpy as np


def neighbours_of(edges, count):
    """Return the set of neighbours of each node."""
    around = [set() for _ in range(count)]
    for a, b in edges:
        if a != b:
            around[a].add(b)
            around[b].add(a)
    return around


def eliminate_slowly(edges, weight, order):
    """Return nonzeros, flops, parents and weighted column heights of an order, joining the neighbours of each node."""
    around = neighbours_of(edges, len(weight))
    position = {int(node): k for k, node in enumerate(order)}
    nonzeros, flops, parent, heights = 0, 0.0, [], []
    for node in (int(n) for n in order):
        later = around[node]
        parent.append(min((position[j] for j in later), default=-1))
        height = int(weight[node]) + sum(int(weight[j]) for j in later)
        heights.append(height)
        for t in range(int(weight[node])):
            nonzeros += height - t
            flops += float(height - t) ** 2
        for j in later:
            around[j] |= later
            around[j] -= {j, node}
    return nonzeros, flops, np.array(parent), np.array(heights)


def minimum_degree_slowly(edges, weight):
    """Return the order that always takes a node of exactly least weighted degree, the lowest number of equals."""
    around = neighbours_of(edges, len(weight))
    left, order = set(range(len(weight))), []
    while left:
        node = min(left, key=lambda i: (sum(int(weight[j]) for j in around[i]), i))
        left.remove(node)
        order.append(node)
        for j in around[node]:
            around[j] |= around[node]
            around[j] -= {j, node}
    return order
