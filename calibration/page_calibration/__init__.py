"""Where K, R and t come from. Empty so far: every recording the runtime reads brings its camera with it."""
