"""The simulator as a process: the `sim` subcommand, its pace, its messages and its pictures."""
