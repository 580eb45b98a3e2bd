"""The proxy without sockets, files or clocks: bytes in, bytes with their due times out.

The *core* verifies, records and routes frames and gives those that faults ask for to the *engine*,
a schedule at work. An *active entry* is one entry of it: when it is active, what it did, its
label. *Senders* is what is remembered of every system and component, in one flat array that the
compiled form shares. The *vehicle clock* makes one timeline of the stamps inside the frames. The
*tape* keeps what came and left until a recorder takes it.
"""
