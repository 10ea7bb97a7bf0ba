"""Programs of rivals on inertial data, run in a process of their own by the interpreter that has them."""
