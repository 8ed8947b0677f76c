/* Lists the Vulkan devices, one a line; exits with 1 where there is none.
 *
 * Driver files on disk tell too little (a driver without its hardware finds no device), and
 * vulkaninfo is not installed everywhere. Needs no Vulkan headers. */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>

typedef void *Instance;
typedef void *Device;

struct instance_info {
    int32_t type; /* 1: VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO */
    const void *next;
    uint32_t flags;
    const void *application;
    uint32_t layer_count;
    const char *const *layers;
    uint32_t extension_count;
    const char *const *extensions;
};

/* The head of VkPhysicalDeviceProperties and room for the rest (824 bytes in all). */
union properties {
    struct {
        uint32_t api, driver, vendor, device;
        int32_t type;
        char name[256];
    } head;
    uint64_t room[512];
};

int main(void) {
    static const char *const types[] = {"other", "integrated", "discrete", "virtual", "software"};
    void *loader = dlopen("libvulkan.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!loader) {
        fprintf(stderr, "no Vulkan loader: %s\n", dlerror());
        return 1;
    }
    int32_t (*create)(const struct instance_info *, const void *, Instance *);
    int32_t (*enumerate)(Instance, uint32_t *, Device *);
    void (*describe)(Device, union properties *);
    *(void **)&create = dlsym(loader, "vkCreateInstance");
    *(void **)&enumerate = dlsym(loader, "vkEnumeratePhysicalDevices");
    *(void **)&describe = dlsym(loader, "vkGetPhysicalDeviceProperties");
    if (!create || !enumerate || !describe) {
        fprintf(stderr, "libvulkan.so.1 is no Vulkan loader\n");
        return 1;
    }
    struct instance_info info = {.type = 1};
    Instance instance;
    if (create(&info, NULL, &instance) != 0) {
        fprintf(stderr, "no Vulkan driver\n");
        return 1;
    }
    Device devices[16];
    uint32_t count = 16;
    if (enumerate(instance, &count, devices) < 0 || count == 0) {
        fprintf(stderr, "no Vulkan device\n");
        return 1;
    }
    for (uint32_t i = 0; i < count; i++) {
        static union properties properties;
        describe(devices[i], &properties);
        int32_t type = properties.head.type;
        printf("Vulkan device: %s (%s)\n", properties.head.name,
               types[type >= 0 && type <= 4 ? type : 0]);
    }
    return 0;
}
