"""The proxy as a process: its subcommands, its event loop, its files and its counters.

The *server* owns links, clock and files and carries out what the core hands back. The *recorder*
writes a session's folder: tlogs, labels, index and journal. *Replay* plays such a folder or any
tlog through the core again; *playback* reads it record by record.
"""
