"""Vehicles: their equations, their parameter files, and what moves.

A *vehicle* advances its state under *controls* in the air around it; *truth* is that state with
the specific force. `*_kernel` and `*_flight` files are compiled.
"""
