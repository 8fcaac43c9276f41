"""Self-calibration: lever arms, clock and camera noise from the visible motion."""
