"""Procedures: one kind of measurement per file, and the technicians' YAML beside them.

Each file has `Settings` (what YAML and the command line may say, values with units) and
`expand(settings, facts) -> Plan`, which turns settings into steps and reports every mistake at once.
A procedure is found by the name of its file.
"""
