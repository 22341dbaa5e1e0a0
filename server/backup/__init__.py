"""A copy of the whole service, made while it works, and the service made anew from it."""
