/* Marks the functions of the shared library that its callers see; all others are hidden. */
#ifndef EDM_EXPORT_H
#define EDM_EXPORT_H

#if defined(_WIN32)
#define EDM_EXPORT __declspec(dllexport)
#else
#define EDM_EXPORT __attribute__((visibility("default")))
#endif

#endif
