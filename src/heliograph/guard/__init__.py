"""What stands between files from strangers and the rest: bounds on what they may ask for, other libraries' errors."""
