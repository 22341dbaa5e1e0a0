"""The pictures of the documentation, made by what they show: `python -m docs.pictures`."""
