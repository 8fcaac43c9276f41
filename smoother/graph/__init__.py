"""All of GTSAM in the core: a window's factor graph built, solved, and read."""
