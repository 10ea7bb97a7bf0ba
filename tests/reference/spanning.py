"""Spanning start, one pose at a time."""

from __future__ import annotations

import numpy as np


def spanning_start(n, i, j, relative):
    k = relative.shape[-1]
    at = [[] for _ in range(n)]
    for e in range(len(i)):
        at[i[e]].append((j[e], relative[e]))
        at[j[e]].append((i[e], np.linalg.inv(relative[e])))
    T = np.zeros((n, k, k))
    root, parent = [None] * n, [None] * n
    for r in range(n):
        if root[r] is not None:
            continue
        T[r], root[r], parent[r] = np.eye(k), r, r
        queue = [r]
        v = r + 1
        while v < n and root[v] is None:
            step = next((Z for w, Z in at[v - 1] if w == v), None)
            if step is None:
                break
            T[v], root[v], parent[v] = T[v - 1] @ step, r, v - 1
            queue.append(v)
            v += 1
        for u in queue:
            for w, Z in at[u]:
                if root[w] is None:
                    T[w], root[w], parent[w] = T[u] @ Z, r, u
                    queue.append(w)
    return T, np.array(root), np.array(parent)
