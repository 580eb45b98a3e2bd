"""What the analysis works on, whatever file or link it came from.

A *sample* is one reading with its stamp; an *epoch* is one receiver epoch of pseudoranges. A
*block* is a table of samples in a row. The *decoder* makes them of MAVLink frames.
"""
