"""From factors to arrays: what the native core solves, in which order, and how it is linearised."""
