"""Differentiable Material Point Method."""
