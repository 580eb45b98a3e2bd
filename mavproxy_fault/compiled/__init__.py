"""The proxy's fast form: the same rules as machine code, from system call to system call.

The *layout* names the columns of the arrays both sides share. *Frames* verifies, patches, counts
and records whole datagrams, *sockets* waits, receives and sends in batches. *Plans* are faults
written down as rows of numbers. The *object file* is their machine code, made once and loaded
without numba. The *forwarder* owns the arrays. docs/compiled.md lists what it supports and what
it does not.
"""
