"""The arm while it moves: a fixed-lag smoother on the graph's own factors, fed sample by sample."""
