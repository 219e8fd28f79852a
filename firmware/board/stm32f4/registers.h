/* Registers of the STM32F429 that this board uses, and no others. Sections are of ST's RM0090 (reference manual) and
 * PM0214 (Cortex-M4). Names as there; a bit is named REGISTER_BIT. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

typedef volatile uint32_t reg32;

#define AT(type, address) ((type *)(uintptr_t)(address))

/* GPIO: RM0090 8.4. Two bits a pin in MODER, OSPEEDR, PUPDR; four in AFR. */
struct gpio {
    reg32 MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFR[2];
};
#define GPIO_PORT(n) AT(struct gpio, 0x40020000u + 0x400u * (n))
enum { PORT_A, PORT_B, PORT_C, PORT_D, PORT_E, PORT_F, PORT_G };

/* Reset and clocks: RM0090 6.3. */
struct rcc {
    reg32 CR, PLLCFGR, CFGR, CIR, AHB1RSTR, AHB2RSTR, AHB3RSTR, reserved1, APB1RSTR, APB2RSTR, reserved2[2];
    reg32 AHB1ENR, AHB2ENR, AHB3ENR, reserved3, APB1ENR, APB2ENR, reserved4[2];
    reg32 AHB1LPENR, AHB2LPENR, AHB3LPENR, reserved5, APB1LPENR, APB2LPENR, reserved6[2];
    reg32 BDCR, CSR;
};
#define RCC AT(struct rcc, 0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_HSEBYP (1u << 18)
#define RCC_CR_CSSON (1u << 19)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR_SRC_HSE (1u << 22)
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS_MASK (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_4 (5u << 10)
#define RCC_CFGR_PPRE2_2 (4u << 13)
#define RCC_CIR_CSSC (1u << 23)
#define RCC_AHB1_GPIO(n) (1u << (n))
#define RCC_AHB1_CCM (1u << 20)
#define RCC_AHB1_DMA1 (1u << 21)
#define RCC_AHB1_DMA2 (1u << 22)
#define RCC_APB1_TIM2 (1u << 0)
#define RCC_APB1_TIM3 (1u << 1)
#define RCC_APB1_TIM4 (1u << 2)
#define RCC_APB1_TIM5 (1u << 3)
#define RCC_APB1_TIM7 (1u << 5)
#define RCC_APB1_TIM13 (1u << 7)
#define RCC_APB1_WWDG (1u << 11)
#define RCC_APB1_USART3 (1u << 18)
#define RCC_APB1_PWR (1u << 28)
#define RCC_APB1_DAC (1u << 29)
#define RCC_APB2_TIM1 (1u << 0)
#define RCC_APB2_TIM8 (1u << 1)
#define RCC_APB2_ADC1 (1u << 8)
#define RCC_APB2_ADC2 (1u << 9)
#define RCC_APB2_ADC3 (1u << 10)
#define RCC_APB2_SPI4 (1u << 13)
#define RCC_APB2_TIM10 (1u << 17)
#define RCC_APB2_TIM11 (1u << 18)
#define RCC_CSR_RMVF (1u << 24)
#define RCC_CSR_BORRSTF (1u << 25)
#define RCC_CSR_PINRSTF (1u << 26)
#define RCC_CSR_PORRSTF (1u << 27)
#define RCC_CSR_SFTRSTF (1u << 28)
#define RCC_CSR_IWDGRSTF (1u << 29)
#define RCC_CSR_WWDGRSTF (1u << 30)
#define RCC_CSR_LPWRRSTF (1u << 31)

/* Power: RM0090 5.5. */
struct pwr {
    reg32 CR, CSR;
};
#define PWR AT(struct pwr, 0x40007000u)
#define PWR_CR_PVDE (1u << 4)
#define PWR_CR_PLS_6 (6u << 5) /* 2.93 V falling, 3.03 V rising (data sheet of the STM32F427/429, 6.3.5) */
#define PWR_CR_DBP (1u << 8)
#define PWR_CR_VOS_1 (3u << 14)
#define PWR_CSR_PVDO (1u << 2) /* the supply is below it */

/* External interrupts: RM0090 12.3. Line 16 is the output of the voltage detector. */
struct exti {
    reg32 IMR, EMR, RTSR, FTSR, SWIER, PR;
};
#define EXTI AT(struct exti, 0x40013C00u)
#define EXTI_PVD (1u << 16)

/* Flash: RM0090 3.9. */
struct flash {
    reg32 ACR;
};
#define FLASH AT(struct flash, 0x40023C00u)
#define FLASH_ACR_LATENCY(n) (n)
#define FLASH_ACR_PRFTEN (1u << 8)
#define FLASH_ACR_ICEN (1u << 9)
#define FLASH_ACR_DCEN (1u << 10)

/* Timers: RM0090 17.4 (TIM1, TIM8), 18.4 (TIM2 to TIM5), 19.5 (TIM10, TIM11, TIM13), 20.4 (TIM7). */
struct timer {
    reg32 CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, RCR, CCR[4], BDTR, DCR, DMAR;
};
#define TIM1 AT(struct timer, 0x40010000u)
#define TIM2 AT(struct timer, 0x40000000u)
#define TIM3 AT(struct timer, 0x40000400u)
#define TIM4 AT(struct timer, 0x40000800u)
#define TIM5 AT(struct timer, 0x40000C00u)
#define TIM7 AT(struct timer, 0x40001400u)
#define TIM8 AT(struct timer, 0x40010400u)
#define TIM10 AT(struct timer, 0x40014400u)
#define TIM11 AT(struct timer, 0x40014800u)
#define TIM13 AT(struct timer, 0x40001C00u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_CR1_OPM (1u << 3)
#define TIM_CR1_ARPE (1u << 7)
#define TIM_CR2_MMS_UPDATE (2u << 4)
#define TIM_SMCR_SMS_TRIGGER 6u
#define TIM_SMCR_TS_TI1FP1 (5u << 4)
#define TIM_SMCR_ETF_4 (2u << 8) /* four samples of the timer's clock agree */
#define TIM_DIER_UIE (1u << 0)
#define TIM_DIER_CC1DE (1u << 9)
#define TIM_DIER_CC2DE (1u << 10)
#define TIM_DIER_CC4DE (1u << 12)
#define TIM_SR_UIF (1u << 0)
#define TIM_SR_BIF (1u << 7)
#define TIM_EGR_UG (1u << 0)
#define TIM_CCMR1_CC1_TI1 (1u << 0)
#define TIM_CCMR1_CC2_TI1 (2u << 8)
#define TIM_CCMR1_OC1_PWM1 (6u << 4 | 1u << 3) /* with preload */
#define TIM_CCMR1_OC1_PWM2_PRELOAD (7u << 4 | 1u << 3)
#define TIM_CCMR1_OC1CE (1u << 7)
#define TIM_CCMR1_OC2_PWM2 (7u << 12)
#define TIM_CCMR2_CC4_TI4 (1u << 8)
#define TIM_CCMR2_OC4_PWM1 (6u << 12)
#define TIM_CCER_CC1E (1u << 0)
#define TIM_CCER_CC2E (1u << 4)
#define TIM_CCER_CC2P (1u << 5)
#define TIM_CCER_CC4E (1u << 12)
#define TIM_BDTR_LOCK_3 (3u << 8)
#define TIM_BDTR_OSSI (1u << 10)
#define TIM_BDTR_OSSR (1u << 11)
#define TIM_BDTR_BKE (1u << 12)
#define TIM_BDTR_MOE (1u << 15)

/* DMA: RM0090 10.5. */
struct dma_stream {
    reg32 CR, NDTR, PAR, M0AR, M1AR, FCR;
};
struct dma {
    reg32 ISR[2], IFCR[2]; /* streams 0 to 3, 4 to 7 */
    struct dma_stream S[8];
};
#define DMA1 AT(struct dma, 0x40026000u)
#define DMA2 AT(struct dma, 0x40026400u)
#define DMA_CR_EN (1u << 0)
#define DMA_CR_MEMORY_TO_PERIPHERAL (1u << 6)
#define DMA_CR_CIRC (1u << 8)
#define DMA_CR_MINC (1u << 10)
#define DMA_CR_PSIZE(bytes) ((uint32_t)(bytes) >> 1 << 11) /* 1, 2 or 4 */
#define DMA_CR_MSIZE(bytes) ((uint32_t)(bytes) >> 1 << 13)
#define DMA_CR_PL(n) ((uint32_t)(n) << 16)
#define DMA_CR_CHSEL(n) ((uint32_t)(n) << 25)

/* ADC: RM0090 13.13. */
struct adc {
    reg32 SR, CR1, CR2, SMPR1, SMPR2, JOFR[4], HTR, LTR, SQR1, SQR2, SQR3, JSQR, JDR[4], DR;
};
struct adc_common {
    reg32 CSR, CCR, CDR;
};
#define ADC1 AT(struct adc, 0x40012000u)
#define ADC2 AT(struct adc, 0x40012100u)
#define ADC3 AT(struct adc, 0x40012200u)
#define ADC_COMMON AT(struct adc_common, 0x40012300u)
#define ADC_SR_OVR (1u << 5)
#define ADC_CR1_SCAN (1u << 8)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_DMA (1u << 8)
#define ADC_CR2_DDS (1u << 9)
#define ADC_CR2_EXTSEL_TIM4_CC4 (9u << 24)
#define ADC_CR2_EXTSEL_TIM8_TRGO (14u << 24)
#define ADC_CR2_EXTEN_RISING (1u << 28)
#define ADC_SQR1_L(n) (((uint32_t)(n) - 1u) << 20)
#define ADC_CCR_DUAL_REGULAR 6u
#define ADC_CCR_DDS (1u << 13)
#define ADC_CCR_DMA_2 (2u << 14)
#define ADC_CCR_DMA_MASK (3u << 14)
#define ADC_CCR_ADCPRE_4 (1u << 16)

/* DAC: RM0090 14.5. */
struct dac {
    reg32 CR, SWTRIGR, DHR12R1, DHR12L1, DHR8R1, DHR12R2, DHR12L2, DHR8R2, DHR12RD;
};
#define DAC AT(struct dac, 0x40007400u)
#define DAC_CR_EN1 (1u << 0)
#define DAC_CR_EN2 (1u << 16)

/* SPI: RM0090 28.5. */
struct spi {
    reg32 CR1, CR2, SR, DR;
};
#define SPI4 AT(struct spi, 0x40013400u)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR_8 (2u << 3)
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_CR1_DFF (1u << 11)
#define SPI_SR_TXE (1u << 1)
#define SPI_SR_BSY (1u << 7)

/* USART: RM0090 30.6. */
struct usart {
    reg32 SR, DR, BRR, CR1, CR2, CR3;
};
#define USART3 AT(struct usart, 0x40004800u)
#define USART_SR_FE (1u << 1)
#define USART_SR_TC (1u << 6)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_UE (1u << 13)
#define USART_CR3_DMAR (1u << 6)
#define USART_CR3_DMAT (1u << 7)

/* Watchdogs: RM0090 21.4 (IWDG), 22.6 (WWDG). */
struct iwdg {
    reg32 KR, PR, RLR, SR;
};
#define IWDG AT(struct iwdg, 0x40003000u)
#define IWDG_KR_FEED 0xAAAAu
#define IWDG_KR_OPEN 0x5555u
#define IWDG_KR_START 0xCCCCu
struct wwdg {
    reg32 CR, CFR, SR;
};
#define WWDG AT(struct wwdg, 0x40002C00u)
#define WWDG_CR_WDGA (1u << 7)

/* What stands still while a debugger halts the core: RM0090 38.16.4. Only the supply resets it. */
#define DBGMCU_APB1_FZ AT(reg32, 0xE0042008u)
#define DBGMCU_APB1_FZ_WWDG (1u << 11)
#define DBGMCU_APB1_FZ_IWDG (1u << 12)

/* Backup registers: RM0090 26.6.20. */
#define RTC_BKP AT(reg32, 0x40002850u)

/* Unique number of the chip: RM0090 39.1. */
#define CHIP_ID AT(const reg32, 0x1FFF7A10u)

/* Cortex-M4: PM0214 4.3 (NVIC), 4.4 (system control block), 4.2 (MPU), 4.6 (FPU). */
#define NVIC_ISER AT(reg32, 0xE000E100u)
#define NVIC_IPR AT(volatile uint8_t, 0xE000E400u) /* the upper four bits; less comes first */
#define SCB_VTOR AT(reg32, 0xE000ED08u)
#define SCB_AIRCR AT(reg32, 0xE000ED0Cu)
#define SCB_AIRCR_RESET (0x05FA0000u | 1u << 2)
#define SCB_SHCSR AT(reg32, 0xE000ED24u)
#define SCB_SHCSR_FAULTS (7u << 16) /* MemManage, BusFault, UsageFault have handlers of their own */
#define SCB_CPACR AT(reg32, 0xE000ED88u)
#define SCB_CPACR_FPU (15u << 20)
#define MPU_CTRL AT(reg32, 0xE000ED94u)
#define MPU_CTRL_ON (1u << 0 | 1u << 2) /* the usual map where no region is */
#define MPU_RNR AT(reg32, 0xE000ED98u)
#define MPU_RBAR AT(reg32, 0xE000ED9Cu)
#define MPU_RASR AT(reg32, 0xE000EDA0u)
#define SRAM_AT 0x20000000u /* RM0090 2.3.1; below it is nothing */
#define MPU_RASR_CLOSED_1K (1u << 28 | 9u << 1 | 1u) /* no access, no execution, 2^(9+1) bytes */

#define IRQ_PVD 1 /* RM0090 12.2, table 62 */
#define IRQ_TIM7 55

static inline void interrupts_off(void) {
    __asm__ volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void) {
    __asm__ volatile("cpsie i\n\tisb" ::: "memory");
}

static inline void wait_for_interrupt(void) {
    __asm__ volatile("dsb\n\twfi" ::: "memory");
}

/* What was written has arrived before what follows. */
static inline void barrier(void) {
    __asm__ volatile("dsb\n\tisb" ::: "memory");
}

/* Switches clocks of peripherals on; what follows finds them running (errata sheet ES0206, 2.1.13). */
static inline void clocks_on(reg32 *enable, uint32_t bits) {
    *enable |= bits;
    (void)*enable;
    barrier();
}

#endif
