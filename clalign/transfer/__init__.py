"""What a correspondence carries from one mesh to the other."""
