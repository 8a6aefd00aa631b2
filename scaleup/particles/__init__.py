"""A particle (DEM) twin of a scene, by an engine that is not ours: LIGGGHTS."""
