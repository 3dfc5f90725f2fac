"""Runs on disk: the append-only journal, blocks beside it, the seal."""
