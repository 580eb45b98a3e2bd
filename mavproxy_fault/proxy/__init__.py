"""The proxy without sockets, files or clocks: bytes in, bytes with their due times out.

The *core* verifies, records and routes frames and passes those that faults act on to the *engine*,
which runs a schedule. An *active entry* is one of its entries with its state, counts and label.
*Senders* is the state of every system and component, in one flat array shared with the compiled
path. The *vehicle clock* merges the timestamps inside the frames into one timeline. The *capture
buffer* stores received and sent frames until the recorder writes them.
"""
