"""Pictures and videos of particles and surfaces, without a display."""
