"""What the bench and the drivers both use: errors, the clock, YAML documents, files, tables and text.

``documents`` checks YAML against models and gives the place of each mistake, ``json_schema`` describes the
models to editors, ``shipped`` finds the project's own files. ``files`` reads and writes whole files,
``csv_tables`` tables. ``packages`` finds dialects and effects of other packages. Functions that run as
machine code are ``kernels``.
"""
