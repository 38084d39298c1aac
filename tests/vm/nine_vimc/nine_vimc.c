// SPDX-License-Identifier: GPL-2.0
// vimc makes one device; this module asks its driver for eight more.
#include <linux/err.h>
#include <linux/module.h>
#include <linux/platform_device.h>

static struct platform_device *devices[8];

static void nine_vimc_exit(void)
{
	int i;

	for (i = 0; i < ARRAY_SIZE(devices); i++)
		platform_device_unregister(devices[i]);
}

static int __init nine_vimc_init(void)
{
	int i;

	for (i = 0; i < ARRAY_SIZE(devices); i++) {
		devices[i] = platform_device_register_simple("vimc", i + 1, NULL, 0);
		if (IS_ERR(devices[i])) {
			int error = PTR_ERR(devices[i]);

			devices[i] = NULL;
			nine_vimc_exit();
			return error;
		}
	}
	return 0;
}

module_init(nine_vimc_init);
module_exit(nine_vimc_exit);
MODULE_DESCRIPTION("Eight more vimc devices: nine in all");
MODULE_LICENSE("GPL");
