"""Who goes where: one even destination for each particle, and the cheapest way to hand them out."""

from morph_engine.optimal_transport.destinations import even_destinations, random_destinations
from morph_engine.optimal_transport.plan import transport_plan

__all__ = ["even_destinations", "random_destinations", "transport_plan"]
