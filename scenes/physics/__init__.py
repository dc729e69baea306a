"""Physics that lets things fall into place, exact on the true meshes."""
