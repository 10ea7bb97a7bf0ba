"""Graph SLAM: keyframes, places, loops, the back-end."""
