"""Files of the service in an object store, for hosts that share no folder."""
