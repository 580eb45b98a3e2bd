"""The proxy as a process: its subcommands, event loop, files and counters.

The *server* owns links, clock and files and sends what the core returns. The *recorder* writes the
folder of a session: tlogs, labels, index and edit log. *Replay* runs such a folder or any tlog
through the core again; *playback* reads it record by record.
"""
