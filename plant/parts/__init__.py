"""What every description is made of: parts with named numbers, and checks of what a user gives.

Read `part` (named numbers, copies, descriptions; `fields` are their types), `settings` (numbers
with usual values) and `arguments` (the checks); then `saved` (files of parts and results: `kinds`
finds their classes, `plain` makes plain data of them, `saved` makes text of it, `files` writes it
whole) and `checkpoint` (finished stages of long work); `csv_rows` (numbers of a text file),
`checked_function` (casadi with checked shapes), `labels` (names of joints), `sums` (in a fixed
order) and `frozen` (results that compare). What a user sees: `tables` (text of 80 columns), `shown`
(results as text and as HTML) and `figures` (axes, colours, legends).
"""
