"""The map, bases and splines of modes, for models on particles and from operators."""
