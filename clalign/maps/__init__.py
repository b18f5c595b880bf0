"""The algebra of maps: point maps, functional maps, nearest neighbours, samples, orientation."""
