"""Reports: facts, sentences, tables, figures, pages and files of each result."""
