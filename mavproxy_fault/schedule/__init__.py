"""Schedules: which faults act, when, and on which frames.

An *entry* is one fault with its target, its time or trigger, and the senders it affects. *Binding*
connects a fault to its target: fields, messages, satellites or the plant. A *trigger* is a
condition on telemetry. A *preset* is a named physical failure, written as entries.
"""
