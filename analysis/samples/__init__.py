"""What the analysis works on: samples and GNSS epochs, whatever file or link they came from.

A *sample* is one reading with its stamp; an *epoch* is one receiver epoch of pseudoranges. A
*block* is a table of samples in a row. The *decoder* makes them of MAVLink frames; recordings,
RINEX, ULog and dataflash readers make the same of files.
"""
