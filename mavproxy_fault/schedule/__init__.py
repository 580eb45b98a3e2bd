"""Schedules: which faults act, when, and on which frames.

An *entry* is one fault with its target, its time or trigger, and whom it is for. *Binding* joins
a fault to what it acts on: fields, whole messages, satellites or the plant. A *trigger* is a
condition over telemetry. A *preset* is a named physical event, written as entries. The
*catalogue* lists what there is; the *preview* draws it.
"""
