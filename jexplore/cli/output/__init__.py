"""Output of commands, and their folders."""
