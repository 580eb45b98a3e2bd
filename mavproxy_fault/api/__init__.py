"""The Python API: control a proxy in this process or another one, and run complete flights.

`Proxy` is the proxy of a test, whose event loop runs in a thread; its `fault` starts a `LiveFault`.
A `RemoteProxy` controls another process over Zenoh; `ProxyObserver` stores the labels and samples
of either. `command_calls` starts `mavproxy-fault run` and others,
`result_folders` reads what they leave.
"""
