"""Records: recordings and measured tables on disk, their clocks and their noise.

`recording` is the object that all read and write. Files of others are read by `readers`, as `record_form` says: texts
by `text_table` (decimal commas: `decimals`), the others by `loggers`, `hdf5`, `matlab_5`, `numpy_files`, `parquet`
and `nested_data`. `soundness` looks for what is wrong with readings, `clock` refuses times that are no steady clock,
`time_base` joins several clocks or resamples, and `wall_clock` reads dates. A run that goes on is written by
`recorder` as a `stream` of `stream_pages`, read by `stream_reader`; `journal` and `file_replacement` keep files whole
after a crash, and `owned_folder` lets one process write a folder.

In: files of recordings and measured tables.
Out: columns on one steady clock, and their noise.
Imports: numerics, display.
"""
