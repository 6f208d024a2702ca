"""Categories of the user's own: models from URDF or mesh files, and scenes of them."""
