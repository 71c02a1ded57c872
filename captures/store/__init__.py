"""The store of captures: checksummed, journalled, resumable."""
