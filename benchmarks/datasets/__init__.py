"""Data sets on disk: stores of captures that are made, made again, estimated and scored."""
