from .destinations import even_destinations as even_destinations
from .destinations import random_destinations as random_destinations
from .plan import transport_plan as transport_plan
