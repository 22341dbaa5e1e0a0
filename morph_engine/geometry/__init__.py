"""Shapes, meshes, and the particles that fill them."""
