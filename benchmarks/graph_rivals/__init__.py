"""Programs that solve one pose graph each, run in a process of their own: ``python FILE GRAPH OUT METHOD [OPTIONS]``.

GRAPH is a g2o file of poses and relative poses that holds the start. The program solves it once to warm up (unless
``--cold``), once more on the clock, writes the poses to OUT (.npy, homogeneous matrices in the order of the vertices)
and prints one JSON object: seconds of ordering, symbolic work and iterations, number of iterations, version.
"""
