"""`edmctl simulate`: virtual machines, one or many, and a served one."""
