/* Version of the firmware: HELLO tells it, and so does the record of an image. */
#ifndef EDM_VERSION_H
#define EDM_VERSION_H

#define FW_MAJOR 1
#define FW_MINOR 0
#define FW_PATCH 0

#endif
