"""From the map of the search to the vertices: ZoomOut, pointwise descriptors, patches, precise maps."""
