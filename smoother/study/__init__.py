"""A study: many recordings recovered with the same settings, here or on a cluster, and what came of each."""
