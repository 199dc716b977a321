"""One HTML page of an identification and its controller: `write_report`.

Read `report`, then `sections` and `page`.
"""
