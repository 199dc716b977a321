"""The command line: ``onepulse check LOG``, ``onepulse identify LOG --robot arm.toml -o found.json``, ..."""
