"""The documentation as a site, built by Sphinx from the documents as they are: `make site`."""
