"""The core's machine code: the same rules, frame by frame, on every link.

The *layout* names the columns of the arrays that both sides share. *Frames* verifies, times, routes
and records frames, *chains* lets faults act on them, *sockets* waits, receives and sends in
batches. *Plans* are faults written down as rows of numbers. The *object file* is the machine code,
made once and loaded without numba. The *compiled core* processes chunks in it and leaves the rest
to the core; the *forwarder* does so on sockets. docs/compiled.md lists what goes which way.
"""
