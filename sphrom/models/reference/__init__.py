"""What models on particles and from operators share: the map, bases and splines of modes."""
