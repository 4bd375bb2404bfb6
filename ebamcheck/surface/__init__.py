"""Surface: what a mesh stands for: its regions, exact surfaces, normals and sagittas, and how far its edges may be lifted."""
