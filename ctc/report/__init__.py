"""One page of an identification and its controller, for whoever has only a browser:
`write_report`.
"""
