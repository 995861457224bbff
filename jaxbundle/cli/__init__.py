"""The command line of jaxbundle, one module for each command."""
