"""Files and folders that are whole or not there, tables that grow row by row, and the user's cache folder."""
