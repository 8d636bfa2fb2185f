"""Common base of the bench and the drivers: errors, the clock, YAML documents, files, tables and text.

``documents`` validates YAML against models and reports the place of each mistake; ``json_schema`` describes
the models to editors; ``shipped`` finds the files that come with the project. ``files`` reads and writes
whole files, ``csv_tables`` CSV tables. ``packages`` finds the dialects and effects of other packages.
``kernels`` compiles numerical functions.
"""
