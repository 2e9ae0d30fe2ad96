"""JSBSim XML to the intermediate form: functions, tables, components, sections of an aircraft,
scripts.
"""
