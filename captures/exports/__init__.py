"""Exports: captures, with or without their truth, as files that other programs read; streamed, complete or continued."""
