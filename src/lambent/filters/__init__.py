"""The classical denoisers, one paper a file, and the registry of all denoisers."""
