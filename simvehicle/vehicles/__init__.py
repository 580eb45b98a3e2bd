"""Vehicles: their equations, their parameter files, and what moves.

A *vehicle* advances its state under *controls* in the air around it; *truth* is that state with
the specific force. Each kind has a room; a rigid body, contact with the ground and the battery
serve all. `*_kernel` and `*_flight` files are compiled; `parameters` holds the shipped sets.
"""
