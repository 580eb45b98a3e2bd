"""Vehicles: their equations of motion, parameter files, controls and truth.

A *vehicle* advances its state under *controls* in the surrounding air; *truth* is that state with
the specific force. Each kind has a package; they share the rigid body, ground contact and battery.
`*_kernel` and `*_flight` files are compiled; `parameters` holds the shipped sets.
"""
