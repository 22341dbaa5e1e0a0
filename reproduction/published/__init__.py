"""What has been published: the numbers of the paper and of its program."""
